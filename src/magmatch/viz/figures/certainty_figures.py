# SPDX-License-Identifier: BSD-3-Clause
"""A pose's uncertainty: ellipsoids of position and rotation, free directions, and rival poses.

The covariance of a result is about the target frame's origin, which may be far from the samples; a small rotation is
a large shift there. At the centroid c of the samples ``xi = (theta, rho)`` moves a point by ``R (rho + theta x c)``.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from scipy.spatial import ConvexHull
from scipy.spatial.transform import RigidTransform
from scipy.special import chdtri

from magmatch.data.survey import Survey, has_order
from magmatch.geometry import covariance_about, rotation_matrix, transform_points
from magmatch.number_text import told
from magmatch.registration.result import DegenerateDirection
from magmatch.typing import Matrix, Points, Scalars, Vector3
from magmatch.viz.figures import draw
from magmatch.viz.figures.slices import cut_through

# Share of the probability inside an ellipsoid that is drawn.
LEVEL = 0.95
# How far the farthest sample is drawn to go along a free direction, in the target's extent.
SWEEP = 0.2
MAX_ARROWS, MAX_SWEPT = 40, 1500


@dataclass(frozen=True, eq=False, slots=True)
class Ellipsoid:
    """A region that holds the truth with the probability `LEVEL`."""

    half_axes: Scalars  # (3,): longest first, in the unit of the covariance's root
    directions: Matrix  # (3, 3): row k is the unit direction of half axis k, base axes

    def surface(self, n: int = 24) -> Points:
        """Points on it: (n + 1, 2 n + 1, 3), rows from pole to pole."""
        polar, azimuth = np.linspace(0, np.pi, n + 1), np.linspace(0, 2 * np.pi, 2 * n + 1)
        ball = np.stack(
            [
                np.outer(np.sin(polar), np.cos(azimuth)),
                np.outer(np.sin(polar), np.sin(azimuth)),
                np.outer(np.cos(polar), np.ones_like(azimuth)),
            ],
            axis=-1,
        )
        # The longest axis is the pole, so that the rings are drawn across it.
        order = [2, 1, 0]
        return np.asarray((ball * self.half_axes[order]) @ self.directions[order])


def ellipsoids_at(covariance: Matrix, T_base_target: RigidTransform, center: Vector3) -> tuple[Ellipsoid, Ellipsoid]:
    """Ellipsoids of the position of a point of the target (m) and of the target's rotation (rad), in base axes."""
    R, C = rotation_matrix(T_base_target), covariance_about(covariance, np.asarray(center))
    return _ellipsoid(R @ C[3:, 3:] @ R.T), _ellipsoid(R @ C[:3, :3] @ R.T)


def swept(p_target: Points, T_base_target: RigidTransform, free: DegenerateDirection, reach: float) -> Points:
    """Points moved along a free direction of the pose, the farthest by `reach`."""
    theta, rho = free.xi[:3], free.xi[3:]
    longest = float(np.linalg.norm(np.cross(theta, p_target) + rho, axis=1).max())
    step = RigidTransform.from_exp_coords(free.xi * (reach / max(longest, 1e-300)))
    return transform_points(p_target, T_base_target * step)


def length_text(metres: float) -> str:
    """A length in a convenient unit."""
    return f"{1e3 * metres:.3g} mm" if metres < 0.9995 else f"{told(metres, 3, 1.0)} m"


def angle_text(radians: float) -> str:
    """An angle in degrees."""
    return f"{np.rad2deg(radians):.3g} deg"


def direction_words(v: Vector3) -> str:
    """Name a direction of the base: an axis if it is near one, else its components."""
    v = v / np.linalg.norm(v)
    k = int(np.argmax(np.abs(v)))
    if abs(v[k]) > 0.97:
        return f"base {'xyz'[k]}"
    return "({:+.2f}, {:+.2f}, {:+.2f})".format(*(v * np.sign(v[k])))


def _ellipsoid(covariance: Matrix) -> Ellipsoid:
    power, vectors = np.linalg.eigh((covariance + covariance.T) / 2)
    scale = float(np.sqrt(chdtri(3, 1 - LEVEL)))
    return Ellipsoid(scale * np.sqrt(np.maximum(power[::-1], 0)), vectors[:, ::-1].T)


def ellipsoid_figure(ellipsoid: Ellipsoid, title: str, unit: str, scale: float, note: str) -> draw.Figure:
    """Draw an ellipsoid with its axes."""
    surface = scale * ellipsoid.surface()
    rings, meridians = [*surface[2:-2:2]], [*surface.swapaxes(0, 1)[:-1:4]]
    gap = np.full((1, 3), np.nan)
    curves = np.concatenate([part for curve in (*rings, *meridians) for part in (curve, gap)])
    thin = {"color": draw.BASE_COLOR, "width": 1.5}
    traces: list[Any] = [draw.curves3d(curves, name=f"{LEVEL:.0%} of the probability", line=thin)]
    for k, (half, direction) in enumerate(zip(scale * ellipsoid.half_axes, ellipsoid.directions, strict=True)):
        end = np.asarray(half * direction)[None]
        line = {"color": draw.TARGET_COLOR, "width": 6, "dash": draw.DASHES[k]}
        name = f"{half:.3g} {unit} along {direction_words(direction)}"
        traces.append(draw.curves3d(draw.between(-end, end), name=name, line=line))
    halves = ", ".join(f"{scale * h:.3g}" for h in ellipsoid.half_axes)
    alt = (
        f"{title}: an ellipsoid that holds the truth with {LEVEL:.0%} probability; half axes {halves} {unit}, "
        f"the longest along {direction_words(ellipsoid.directions[0])}."
    )
    return draw.new_scene(title, traces, note, alt, unit=unit)


def free_figure(
    base: Survey, target: Survey, T_base_target: RigidTransform, free: DegenerateDirection
) -> draw.Figure:
    """Draw a free direction: the target moved both ways along it."""
    p_target = target.positions[draw.thinned(len(target), MAX_SWEPT)]
    reach = SWEEP * float(np.ptp(p_target, axis=0).max())
    here = transform_points(p_target, T_base_target)
    ways = [swept(p_target, T_base_target, free, sign * reach) for sign in (-1.0, 1.0)]
    arrows = draw.thinned(len(p_target), MAX_ARROWS)
    p_base = base.positions[draw.thinned(len(base), MAX_SWEPT)]
    style: dict[str, Any] = {"opacity": 0.7, "hoverinfo": "name"}
    line = {"color": draw.INK, "width": 3}
    traces = [
        draw.marks3d(p_base, f"base: {draw.label(base.name)}", draw.BASE_COLOR, draw.BASE_MARKER, 1.5, opacity=0.5),
        draw.marks3d(here, "target", draw.TARGET_COLOR, draw.TARGET_MARKER, 2.5, **style),
        draw.marks3d(ways[0], "moved one way", draw.LINK_COLOR, "cross", 2, **style),
        draw.marks3d(ways[1], "moved the other way", draw.LINK_COLOR, "x", 2, **style),
        draw.curves3d(draw.between(ways[0][arrows], ways[1][arrows]), name="direction", line=line),
    ]
    title, note = f"Free: {draw.label(free.words)}", "the data fit nearly as well all along the lines"
    alt = f"The target's samples with lines along which they may move and still fit: {free.words}."
    return draw.new_scene(title, traces, note, alt)


def poses_figure(base: Survey, target: Survey, poses: Sequence[RigidTransform]) -> draw.Figure:
    """Draw the target under each of several poses: numbered outlines, or paths, in plan view."""
    p_target = target.positions[draw.thinned(len(target), MAX_SWEPT)]
    lain = [transform_points(p_target, T) for T in poses]
    cut = cut_through(np.concatenate([base.positions, *lain]))
    dots = {"size": 3, "color": draw.BASE_COLOR, "opacity": 0.35}
    p_base = base.positions[draw.thinned(len(base), MAX_SWEPT)]
    traces = [draw.flat(cut.along(p_base), marker=dots, name=f"base: {draw.label(base.name)}", hoverinfo="skip")]
    for k, p in enumerate(lain):
        line = {"color": draw.TARGET_COLOR, "width": 1.5 if k else 3.5, "dash": draw.DASHES[k % len(draw.DASHES)]}
        outline = _outline(cut.along(p), is_path=has_order(target))
        traces.append(draw.flat(outline, "lines", line=line, name=f"pose {k + 1}", hoverinfo="name"))
        text = {"text": [f"<b>{k + 1}</b>"], "textfont": {"size": 18, "color": draw.INK}}
        traces.append(draw.flat(cut.along(p).mean(axis=0)[None], "text", hoverinfo="skip", showlegend=False, **text))
    a, b, c = ("xyz"[axis] for axis in cut.axes)
    title = f"The target under each pose<br><sub>base frame, seen along {c}; numbers as in the table</sub>"
    middles = [p.mean(axis=0)[list(cut.axes[:2])] for p in lain]
    places = "; ".join(f"{k + 1} around {a} {x:.2f}, {b} {y:.2f} m" for k, (x, y) in enumerate(middles))
    return cut.figure(title, traces, f"Plan of the base with the outline of the target under each pose: {places}.")


def _outline(p: np.ndarray, *, is_path: bool) -> np.ndarray:
    """The way itself, or the hull of what has no order."""
    if is_path or np.linalg.matrix_rank(p - p[0], tol=1e-6) < 2:
        return p
    corners = ConvexHull(p).vertices
    return np.asarray(p[[*corners, corners[0]]])
