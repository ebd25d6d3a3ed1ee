# SPDX-License-Identifier: BSD-3-Clause
"""How much of the box around its samples a map knows, and how well."""

from dataclasses import dataclass

import numpy as np

from magmatch.data.survey import Survey
from magmatch.field.map import FieldMap
from magmatch.typing import Mask, Points, Scalars

# Points of the box at which the map is evaluated.
N_ASKED = 6000


@dataclass(frozen=True, eq=False, slots=True)
class Coverage:
    """A map evaluated at points throughout the box around its samples."""

    known_share: float  # share of the box that the map knows
    volume: float  # m^3: of the box
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
        volume=float(size.prod()),
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
