# SPDX-License-Identifier: BSD-3-Clause
"""Pictures of a pose's uncertainty: ellipsoids of position and rotation, free directions, and rival poses."""

from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

import numpy as np
from scipy.spatial import ConvexHull
from scipy.spatial.transform import RigidTransform

from magmatch.data.order import has_order
from magmatch.data.survey import Survey
from magmatch.geometry import transform_points
from magmatch.registration.result import DegenerateDirection
from magmatch.typing import Points
from magmatch.viz.figures.ellipsoids import LEVEL, Ellipsoid, direction_words, swept
from magmatch.viz.figures.plotting import (
    BASE_COLOR,
    INK,
    LINK_COLOR,
    TARGET_COLOR,
    TARGET_MARKER,
    between,
    curves3d,
    described,
    flat,
    label,
    new_scene,
    points3d,
    thinned,
)
from magmatch.viz.figures.slices import cut_through

if TYPE_CHECKING:
    from plotly.graph_objects import Figure

DASHES = ("solid", "dash", "dot", "dashdot", "longdash", "longdashdot")
# How far the farthest sample is drawn to go along a free direction, in the target's extent.
SWEEP = 0.2
MAX_ARROWS, MAX_SWEPT = 40, 1500


def ellipsoid_figure(ellipsoid: Ellipsoid, title: str, unit: str, scale: float, note: str) -> "Figure":
    """Draw an ellipsoid with its axes."""
    surface = scale * ellipsoid.surface()
    rings, meridians = [*surface[2:-2:2]], [*surface.swapaxes(0, 1)[:-1:4]]
    gap = np.full((1, 3), np.nan)
    curves = np.concatenate([part for curve in (*rings, *meridians) for part in (curve, gap)])
    thin = {"color": BASE_COLOR, "width": 1.5}
    traces: list[Any] = [curves3d(curves, name=f"{LEVEL:.0%} of the probability", line=thin)]
    for k, (half, direction) in enumerate(zip(scale * ellipsoid.half_axes, ellipsoid.directions, strict=True)):
        end = np.asarray(half * direction)[None]
        line = {"color": TARGET_COLOR, "width": 6, "dash": DASHES[k]}
        name = f"{half:.3g} {unit} along {direction_words(direction)}"
        traces.append(curves3d(between(-end, end), name=name, line=line))
    figure = new_scene(title, traces, note, unit=unit)
    halves = ", ".join(f"{scale * h:.3g}" for h in ellipsoid.half_axes)
    return described(
        figure,
        f"{title}: an ellipsoid that holds the truth with {LEVEL:.0%} probability; half axes {halves} {unit}, "
        f"the longest along {direction_words(ellipsoid.directions[0])}.",
    )


def free_figure(base: Survey, target: Survey, T_base_target: RigidTransform, free: DegenerateDirection) -> "Figure":
    """Draw a free direction: the target moved both ways along it."""
    p_target = target.positions[thinned(len(target), MAX_SWEPT)]
    reach = SWEEP * float(np.ptp(p_target, axis=0).max())
    here = transform_points(p_target, T_base_target)
    ways = [swept(p_target, T_base_target, free, sign * reach) for sign in (-1.0, 1.0)]
    arrows = thinned(len(p_target), MAX_ARROWS)
    p_base = base.positions[thinned(len(base), MAX_SWEPT)]
    traces = [
        points3d(p_base, name=f"base: {label(base.name)}", marker={"size": 1.5, "color": BASE_COLOR, "opacity": 0.5}),
        _points(here, "target", TARGET_MARKER, TARGET_COLOR, 2.5),
        _points(ways[0], "moved one way", "cross", LINK_COLOR, 2),
        _points(ways[1], "moved the other way", "x", LINK_COLOR, 2),
        curves3d(between(ways[0][arrows], ways[1][arrows]), name="direction", line={"color": INK, "width": 3}),
    ]
    figure = new_scene(f"Free: {label(free.words)}", traces, "the data fit nearly as well all along the lines")
    return described(
        figure,
        f"The target's samples with lines along which they may move and still fit: {free.words}.",
    )


def _points(p: Points, name: str, symbol: str, color: str, size: float) -> Any:
    marker = {"size": size, "color": color, "symbol": symbol, "opacity": 0.7}
    return points3d(p, name=name, marker=marker, hoverinfo="name")


def poses_figure(base: Survey, target: Survey, poses: Sequence[RigidTransform]) -> "Figure":
    """Draw the target under each of several poses: numbered outlines, or paths, in plan view."""
    p_target = target.positions[thinned(len(target), MAX_SWEPT)]
    lain = [transform_points(p_target, T) for T in poses]
    cut = cut_through(np.concatenate([base.positions, *lain]))
    dots, p_base = {"size": 3, "color": BASE_COLOR, "opacity": 0.35}, base.positions[thinned(len(base), MAX_SWEPT)]
    traces = [flat(cut.along(p_base), marker=dots, name=f"base: {label(base.name)}", hoverinfo="skip")]
    for k, p in enumerate(lain):
        line = {"color": TARGET_COLOR, "width": 1.5 if k else 3.5, "dash": DASHES[k % len(DASHES)]}
        outline = _outline(cut.along(p), is_path=has_order(target))
        traces.append(flat(outline, "lines", line=line, name=f"pose {k + 1}", hoverinfo="name"))
        text = {"text": [f"<b>{k + 1}</b>"], "textfont": {"size": 18, "color": INK}}
        traces.append(flat(cut.along(p).mean(axis=0)[None], "text", hoverinfo="skip", showlegend=False, **text))
    a, b, c = ("xyz"[axis] for axis in cut.axes)
    title = f"The target under each pose<br><sub>base frame, seen along {c}; numbers as in the table</sub>"
    figure, middles = cut.figure(title, traces), [p.mean(axis=0)[list(cut.axes[:2])] for p in lain]
    places = "; ".join(f"{k + 1} around {a} {x:.2f}, {b} {y:.2f} m" for k, (x, y) in enumerate(middles))
    return described(figure, f"Plan of the base with the outline of the target under each pose: {places}.")


def _outline(p: np.ndarray, *, is_path: bool) -> np.ndarray:
    """The way itself, or the hull of what has no order."""
    if is_path or np.linalg.matrix_rank(p - p[0], tol=1e-6) < 2:
        return p
    corners = ConvexHull(p).vertices
    return np.asarray(p[[*corners, corners[0]]])
