# SPDX-License-Identifier: BSD-3-Clause
"""Pictures of one map: the field on cuts, and how well it is known where."""

from dataclasses import dataclass

import numpy as np

from magmatch.data.survey import Survey
from magmatch.field.map import FieldMap
from magmatch.typing import Mask, Points, Scalars
from magmatch.viz.figures import draw
from magmatch.viz.figures.slices import (
    Cut,
    common_limits,
    cut_normal_to,
    cut_through,
    field_on,
    limits_of,
    magnitude_slice,
    slice_figure,
)

# Points of the box at which the map is evaluated.
N_ASKED = 6000
# A box at least this thick, in its longest side, is cut along all three axes.
THICK = 0.15
# Samples marked on a cut, those nearest to it.
MAX_MARKED = 400


@dataclass(frozen=True, eq=False, slots=True)
class Coverage:
    """A map evaluated at points throughout the box around its samples."""

    known_share: float  # share of the box that the map knows
    sd: Scalars  # (n,), T: standard deviation of one component of the field at the known points, increasing
    variation: float  # T: standard deviation of one component over the samples: the error of a map without structure

    def share_below(self, sd: float) -> float:
        """Share of the known part with at most this standard deviation."""
        return float((self.sd <= sd).mean()) if len(self.sd) else 0.0

    def quantile(self, share: float) -> float | None:
        """Quantile of the standard deviation over the known part; None if nothing is known."""
        return float(np.quantile(self.sd, share)) if len(self.sd) else None


def cover_and_spread(field_map: FieldMap, points: Points) -> tuple[Coverage, Scalars]:
    """Coverage of the box around a map's samples, and the standard deviation of a component (T) at other points.

    One query for both: the tiles of a large map keep no factors, and making them takes nearly all the time.
    """
    size = np.ptp(field_map.survey.transformed(field_map.T_map_model.inv()).positions, axis=0)
    sides = np.maximum(size, 0.02 * size.max())  # of a flat survey the thickness hardly matters
    grid = field_map.grid_over(float((sides.prod() / N_ASKED) ** (1 / 3)) or 1.0)
    box = grid.points()
    is_known = field_map.knows(box)
    asked = np.concatenate([box[is_known], points])
    sd = np.sqrt(np.maximum(np.trace(field_map.covariance(asked), axis1=1, axis2=2) / 3, 0))
    n = int(is_known.sum())
    coverage = Coverage(
        known_share=float(is_known.mean()),
        sd=np.sort(sd[:n]),
        variation=float(np.sqrt(field_map.survey.field.var(axis=0).mean())),
    )
    return coverage, sd[n:]


def left_out(field_map: FieldMap, read: Survey) -> Mask:
    """Samples of a survey that the map was not made from."""
    kept = {row.tobytes() for part in field_map.surveys for row in _rows(part)}
    return np.array([row.tobytes() not in kept for row in _rows(read)], dtype=bool)


def _rows(survey: Survey) -> np.ndarray:
    return np.ascontiguousarray(np.hstack([survey.positions, survey.field]))


def field_figures(field_map: FieldMap) -> list[draw.Figure]:
    """Magnitude on every cut worth drawing, and the three components on the main one."""
    p, limits = field_map.survey.positions, limits_of(field_map)
    main = cut_through(p)
    field, is_known = field_on(main, field_map)
    name = draw.label(field_map.survey.name)
    figures = [magnitude_slice(f"{name}: |B|, posterior mean", main, field, is_known, limits)]
    for k, axis in enumerate("xyz"):
        values = draw.UT_PER_TESLA * field[:, k]
        range_k = common_limits(draw.UT_PER_TESLA * field_map.survey.field[:, k])
        figures.append(slice_figure(f"B{axis}", main, values, is_known, range_k, draw.FIELD_SCALE))
    size = np.ptp(p, axis=0)
    for normal in main.axes[:2] if size.min() >= THICK * size.max() else ():
        cut = cut_normal_to(p, normal)
        figures.append(magnitude_slice("|B|, across", cut, *field_on(cut, field_map), limits))
    return figures


def spread_figure(field_map: FieldMap, cut: Cut, sd: Scalars) -> draw.Figure:
    """Standard deviation of a component on a cut, with the samples nearest to it."""
    p = field_map.survey.positions
    sd, is_known = draw.UT_PER_TESLA * sd, field_map.knows(cut.points)
    nearest = np.argsort(np.abs(p[:, cut.axes[2]] - cut.height), kind="stable")[:MAX_MARKED]
    circles = {"size": 3, "color": draw.PAPER, "line": {"color": draw.INK, "width": 0.7}}
    marks = draw.flat(cut.along(p[nearest]), marker=circles, name="samples", hoverinfo="skip")
    limits = common_limits(sd[is_known])
    note = f"; circles: the {len(nearest)} samples nearest to the cut"
    return slice_figure(
        "Standard deviation of a component", cut, sd, is_known, limits, draw.SPREAD_SCALE, [marks], note
    )
