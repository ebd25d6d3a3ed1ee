# SPDX-License-Identifier: BSD-3-Clause
"""Spacing of the splines over samples, their reach beyond them, and what of both a survey can afford."""

import logging
from dataclasses import dataclass, replace

import numpy as np

from magmatch.field.cholesky.cells import MAX_BOX_CELLS
from magmatch.field.folds import has_path_order
from magmatch.field.hyperparameters import Hyperparameters
from magmatch.field.selection.evidence_climb import is_allowed, rounded
from magmatch.field.subset import distinct_places, sample_distance
from magmatch.field.tiles.region_model import fit_operations
from magmatch.typing import Points

log = logging.getLogger(__name__)

# Least spacing, in units of the samples' distance: closer splines are more than samples tell apart, or tell for less
# than they cost, which of few samples is little. Where these lie anywhere the reach follows the widest gap that they
# may leave between them, and half a cell.
CLOSEST_SPLINES, CLOSEST_OF_FEW, CLOSEST_OF_A_PATH, WIDEST_GAP = 1.05, 0.75, 0.4, 1.3
FEW_SAMPLES = 500
# Samples anywhere in a volume fill it; the lanes of a path leave gaps, which the basis has to bridge.
REACH, REACH_OF_A_PATH = 1.5, 2.0
# How far a smooth field is extrapolated, in lengthscales: beyond samples that lie anywhere, and farther beyond a
# plane, outside which everything is; what that is worth against closer splines.
EXTRAPOLATED, EXTRAPOLATED_FROM_A_PLANE, WORTH_OF_EXTRAPOLATION = 0.3, 0.6, 4.0
# The next spacing that is tried.
FINER = 0.75
# Operations of one fit of the whole survey, a constant and a share per sample: at the finest spacing that the search
# may wish for, and at most; a spacing that would cost more than the last is widened.
FINE_OPERATIONS, MOST_OPERATIONS = (4e9, 2e5), (1e11, 1.5e6)
COARSER = 1.25


@dataclass(frozen=True, slots=True)
class SplineLayout:
    """Layout of splines over samples: samples' distance (`sample_distance`, m), least spacing (m), whether a path."""

    distance: float
    closest: float
    is_path: bool

    @classmethod
    def over(cls, points: Points) -> "SplineLayout":
        """Layout that these samples ask for."""
        places, is_path = distinct_places(points), has_path_order(points)
        distance = sample_distance(places)
        anywhere = CLOSEST_OF_FEW if len(places) <= FEW_SAMPLES else CLOSEST_SPLINES
        return cls(distance, (CLOSEST_OF_A_PATH if is_path else anywhere) * distance, is_path)

    def reach(self, spacing: float) -> float:
        """Give the distance beyond samples to which cells of a spacing have to reach."""
        return REACH_OF_A_PATH if self.is_path else rounded(max(REACH, WIDEST_GAP * self.distance / spacing + 0.5))

    def extrapolating(self, points: Points, h: Hyperparameters) -> Hyperparameters:
        """Numbers whose reach covers what their field can be extrapolated to, as far as the survey can afford it."""
        if self.is_path:
            return h
        # Of samples evenly through a layer, twelve times the variance is the square of its thickness.
        thickness = np.sqrt(12 * max(float(np.linalg.eigvalsh(np.cov(points.T))[0]), 0.0))
        is_thin = thickness < h.lengthscale / 2
        farthest = (EXTRAPOLATED_FROM_A_PLANE if is_thin else EXTRAPOLATED) * h.lengthscale / h.spacing + 0.5
        tried = (replace(h, reach=rounded(share * farthest)) for share in (1.0, 0.8, 0.65))
        return next((t for t in tried if t.reach > h.reach and is_affordable(points, t, WORTH_OF_EXTRAPOLATION)), h)

    def finer(self, points: Points, h: Hyperparameters) -> Hyperparameters | None:
        """The next spacing, where samples tell it apart and the survey can afford it."""
        spacing = rounded(FINER * h.spacing)
        if spacing < self.closest:
            return None
        other = replace(h, spacing=spacing, reach=self.reach(spacing))
        return other if is_allowed(other) and is_affordable(points, other) else None


def affordable_spacing(points: Points, hyperparameters: Hyperparameters) -> float:
    """A spacing, widened until the whole survey can be fitted in bounded time and memory."""
    h, spacing = hyperparameters, hyperparameters.spacing
    while _operations(points, h, spacing) > _budget(MOST_OPERATIONS, len(points)):
        spacing *= COARSER
    if spacing > h.spacing:
        log.warning("the survey is large: spacing widened from %.3g m to %.3g m", h.spacing, spacing)
    return spacing


def is_affordable(points: Points, hyperparameters: Hyperparameters, times: float = 1.0) -> bool:
    """Whether a survey can be fitted at a spacing finer than it has to be; ``times``: of what that may cost."""
    budget = times * _budget(FINE_OPERATIONS, len(points))
    return _operations(points, hyperparameters, hyperparameters.spacing) <= budget


def _operations(points: Points, h: Hyperparameters, spacing: float) -> float:
    """Cost of one fit over the surroundings of points; infinite where the search could not lay its cells at once."""
    if np.prod(np.ptp(points, axis=0) / spacing + 2 * h.reach + 1) > MAX_BOX_CELLS:
        return np.inf
    ratio = h.lengthscale / h.spacing
    return fit_operations(points, Hyperparameters(ratio * spacing, 1.0, 1.0, spacing, reach=h.reach))


def _budget(terms: tuple[float, float], n: int) -> float:
    return terms[0] + terms[1] * n
