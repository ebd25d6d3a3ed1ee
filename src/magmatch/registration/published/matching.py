# SPDX-License-Identifier: BSD-3-Clause
"""Correspondences: keypoints of two maps whose descriptors look alike."""

from dataclasses import dataclass

import numpy as np
from pydantic import BaseModel, ConfigDict, Field

from magmatch.features.features import Features
from magmatch.typing import Indices, Matrix, Scalars

# Pairs of descriptors compared at once: bounds memory.
_PAIRS_AT_ONCE = 4_000_000


class MatchingConfig(BaseModel):
    """Which nearest neighbours in descriptor space are believed."""

    model_config = ConfigDict(frozen=True, extra="forbid")

    # Largest distance of two descriptors (each histogram sums to at most 1). None: no bound.
    max_distance: float | None = Field(default=None, gt=0)
    # Share of the nearest neighbours, closest first, that is kept: the threshold adapts to noise and grid.
    kept_share: float = Field(default=0.5, gt=0, le=1)
    # Largest ratio to the distance of the second nearest; 1 leaves the test out (published).
    max_ratio: float = Field(default=1.0, gt=0, le=1)
    # Whether both must be each other's nearest (published: no).
    is_mutual: bool = False


@dataclass(frozen=True, eq=False, slots=True)
class Correspondences:
    """Rows that belong together.

    Attributes
    ----------
    base_rows, target_rows : (c,) int arrays
        Keypoints of each map.
    distance : (c,) array
        Between their descriptors.
    """

    base_rows: Indices
    target_rows: Indices
    distance: Scalars

    def __len__(self) -> int:
        return len(self.base_rows)


def match_features(base: Features, target: Features, config: MatchingConfig) -> Correspondences:
    """Find for each target keypoint the base keypoint with the nearest descriptor.

    Parameters
    ----------
    base, target : Features
        Described with the same spacing and ranges.
    config : MatchingConfig

    Returns
    -------
    Correspondences
        In the order of the target's keypoints.
    """
    none = np.zeros(0, dtype=np.int64)
    if not len(base) or not len(target):
        return Correspondences(none, none, np.zeros(0))
    found, rows = _nearest(base.descriptors, target.descriptors, min(2, len(base)))
    distance, base_rows = found[:, 0], rows[:, 0]
    is_kept = distance <= np.quantile(distance, config.kept_share)
    if config.max_distance is not None:
        is_kept &= distance <= config.max_distance
    if config.max_ratio < 1 and found.shape[1] > 1:
        is_kept &= distance <= config.max_ratio * found[:, 1]
    if config.is_mutual:
        _, back = _nearest(target.descriptors, base.descriptors, 1)
        is_kept &= back[base_rows, 0] == np.arange(len(target))
    target_rows = np.flatnonzero(is_kept).astype(np.int64)
    return Correspondences(base_rows[is_kept], target_rows, distance[is_kept])


def _nearest(among: Matrix, wanted: Matrix, n_neighbours: int) -> tuple[Matrix, np.ndarray]:
    """Distances and rows of the nearest descriptors, nearest first, both (n, n_neighbours)."""
    # Matrix products: in 90 dimensions a k-d tree looks at nearly every point, ten times slower.
    rows = np.zeros((len(wanted), n_neighbours), dtype=np.int64)
    half_norm2 = (among**2).sum(axis=1) / 2
    step = max(_PAIRS_AT_ONCE // len(among), 1)
    for start in range(0, len(wanted), step):
        part = slice(start, start + step)
        lead = half_norm2 - wanted[part] @ among.T
        for k in range(n_neighbours):
            rows[part, k] = lead.argmin(axis=1)
            lead[np.arange(len(lead)), rows[part, k]] = np.inf
    return np.linalg.norm(among[rows] - wanted[:, None], axis=2), rows
