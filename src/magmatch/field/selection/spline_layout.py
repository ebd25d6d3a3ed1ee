# SPDX-License-Identifier: BSD-3-Clause
"""Spacing of the splines over samples, and their reach beyond them."""

from dataclasses import dataclass, replace

import numpy as np

from magmatch.field.folds import has_path_order
from magmatch.field.hyperparameters import Hyperparameters
from magmatch.field.selection.affordability import is_affordable
from magmatch.field.selection.evidence_climb import is_allowed, rounded
from magmatch.field.subset import sample_distance
from magmatch.typing import Points

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


@dataclass(frozen=True, slots=True)
class SplineLayout:
    """Layout of splines over samples: samples' distance (`sample_distance`, m), least spacing (m), whether a path."""

    distance: float
    closest: float
    is_path: bool

    @classmethod
    def over(cls, points: Points) -> "SplineLayout":
        """Layout that these samples ask for."""
        distance, is_path = sample_distance(points), has_path_order(points)
        anywhere = CLOSEST_OF_FEW if len(points) <= FEW_SAMPLES else CLOSEST_SPLINES
        return cls(distance, (CLOSEST_OF_A_PATH if is_path else anywhere) * distance, is_path)

    def reach(self, spacing: float) -> float:
        """How far beyond samples cells of a spacing have to reach."""
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
