# SPDX-License-Identifier: BSD-3-Clause
"""Flat cuts through maps."""

from dataclasses import dataclass
from typing import Any

import numpy as np
from scipy.spatial.transform import RigidTransform

from magmatch.data.survey import Survey
from magmatch.field.map import FieldMap
from magmatch.geometry import rotate_vectors, transform_points
from magmatch.registration.maps import survey_of
from magmatch.typing import Mask, Points, Scalars, Vector3, Vectors
from magmatch.viz.figures import draw

# Cells along the longer side of a cut.
N_ALONG = 110
# A box this much flatter than it is wide is cut parallel to its flat side; others horizontally.
FLATNESS = 0.7


@dataclass(frozen=True, eq=False, slots=True)
class Cut:
    """A plane of points normal to one axis of a frame."""

    points: Points  # (n, 3), m: row-major over (second axis, first axis)
    first: Scalars  # (k,), m: coordinates along the two axes that span the plane, without the origin
    second: Scalars  # (k,), m
    axes: tuple[int, int, int]  # (int, int, int): which axes are first, second and normal
    height: float  # m: where the plane cuts the normal axis
    origin: Vector3  # (3,), m: taken off what is drawn, and named on the axes

    @property
    def words(self) -> str:
        """The place of the plane, in words."""
        return f"{'xyz'[self.axes[2]]} = {round(self.height, 2) + 0.0:.2f} m"

    def along(self, p: np.ndarray) -> np.ndarray:
        """The two coordinates of points (n, 3) along the plane, as they are drawn: without the origin."""
        return np.asarray(p - self.origin)[:, list(self.axes[:2])]

    def figure(self, title: str, traces: list[Any], alt: str) -> draw.Figure:
        """Put traces into a figure of the plane."""
        x_title, y_title = (draw.axis_title(axis, self.origin) for axis in self.axes[:2])
        return draw.new_plane(title, traces, x_title, y_title, alt)


def map_in(drawn: Survey | FieldMap | None) -> FieldMap | None:
    """The map that is drawn, which can be cut; None where a survey is drawn, which has samples alone."""
    return drawn if isinstance(drawn, FieldMap) else None


def cut_through(p: Points) -> Cut:
    """Cut the box of points through their median, parallel to its flattest side."""
    size = np.ptp(p, axis=0)
    flattest = int(np.argmin(size))
    return cut_normal_to(p, flattest if size[flattest] < FLATNESS * np.sort(size)[1] else 2)


def cut_normal_to(p: Points, normal: int, height: float | None = None) -> Cut:
    """Cut the box of points across one axis."""
    low, high = p.min(axis=0), p.max(axis=0)
    a, b = (axis for axis in range(3) if axis != normal)
    step = max(float(max(high[a] - low[a], high[b] - low[b])) / (N_ALONG - 1), 1e-6)
    margin = 2 * step
    first = np.arange(low[a] - margin, high[a] + margin + step, step)
    second = np.arange(low[b] - margin, high[b] + margin + step, step)
    height = float(np.median(p[:, normal])) if height is None else height
    points = np.empty((len(second), len(first), 3))
    points[..., a], points[..., b], points[..., normal] = first[None, :], second[:, None], height
    origin = draw.origin_of(p)
    return Cut(points.reshape(-1, 3), first - origin[a], second - origin[b], (a, b, normal), height, origin)


def field_on(cut: Cut, field_map: FieldMap, T_cut_map: RigidTransform | None = None) -> tuple[Vectors, Mask]:
    """Field of a map on a cut (T, the cut's frame), and where the map knows it."""
    T = RigidTransform.identity() if T_cut_map is None else T_cut_map
    p_map = transform_points(cut.points, T.inv())
    return rotate_vectors(field_map.evaluate(p_map).field, T), field_map.knows(p_map)


def heatmap(cut: Cut, values: Scalars, is_known: Mask, limits: tuple[float, float], scale: Any, **style: Any) -> Any:
    """Draw numbers in uT over a cut; blank where they are not known."""
    image = np.where(is_known, values, np.nan).reshape(len(cut.second), len(cut.first))
    names = ["xyz"[axis] for axis in cut.axes]
    style = {
        "zmin": limits[0],
        "zmax": limits[1],
        "colorscale": scale,
        "colorbar": draw.colorbar("uT"),
        "hovertemplate": f"{names[0]} %{{x:.2f}} m, {names[1]} %{{y:.2f}} m<br>%{{z:.2f}} uT<extra></extra>",
    } | style
    x, y, z = draw.for_display(cut.first), draw.for_display(cut.second), draw.for_display(image)
    return draw.require_plotly().Heatmap(x=x, y=y, z=z, **style)


def slice_figure(
    title: str,
    cut: Cut,
    values: Scalars,
    is_known: Mask,
    limits: tuple[float, float],
    scale: str,
    marks: Any = (),
    note: str = "",
) -> draw.Figure:
    """Draw numbers in uT over a cut, with marks on it that a note explains."""
    traces, known = [heatmap(cut, values, is_known, limits, scale), *marks], values[is_known]
    spread = (
        f"from {known.min():.3g} to {known.max():.3g} uT, median {np.median(known):.3g}" if len(known) else "none"
    )
    alt = f"{title}, cut at {cut.words}: {spread}; {is_known.mean():.0%} of the cut is known."
    return cut.figure(f"{title}<br><sub>{cut.words}{note}</sub>", traces, alt).update_layout(showlegend=False)


def magnitude_slice(
    title: str, cut: Cut, field: Vectors, is_known: Mask, limits: tuple[float, float], marks: Any = (), note: str = ""
) -> draw.Figure:
    """Draw the field's magnitude over a cut."""
    return slice_figure(title, cut, draw.magnitude_ut(field), is_known, limits, draw.FIELD_SCALE, marks, note)


def limits_of(*shown: Survey | FieldMap) -> tuple[float, float]:
    """One colour range for field magnitudes in uT.

    It is that of the samples: between and beyond them a map may swing farther than anything that was measured.
    """
    return common_limits(*(draw.magnitude_ut(survey_of(one).field) for one in shown))


def common_limits(*parts: Scalars) -> tuple[float, float]:
    """One colour range for several pictures: all but the most extreme hundredths."""
    values = np.concatenate(parts)
    if not len(values):
        return 0.0, 1.0
    low, high = np.percentile(values, [1, 99])
    return float(low), float(max(high, low + 1e-6))
