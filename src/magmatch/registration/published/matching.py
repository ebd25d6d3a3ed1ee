# SPDX-License-Identifier: BSD-3-Clause
"""Correspondences: keypoints of two maps with similar descriptors."""

from dataclasses import dataclass

import numpy as np
from pydantic import Field

from magmatch.features.features import Features
from magmatch.settings import Settings
from magmatch.typing import Indices, Matrix, Scalars

# Pairs of descriptors compared at once: bounds memory.
_PAIRS_AT_ONCE = 4_000_000


class MatchingConfig(Settings):
    """Which nearest neighbours in descriptor space are used."""

    # Share of the nearest neighbours, closest first, that is kept: the threshold adapts to noise and grid.
    kept_share: float = Field(default=0.5, gt=0, le=1)


@dataclass(frozen=True, eq=False, slots=True)
class Correspondences:
    """Rows of corresponding keypoints."""

    # (c,) ints: keypoints of each map
    base_rows: Indices
    target_rows: Indices
    distance: Scalars  # (c,): between their descriptors

    def __len__(self) -> int:
        return len(self.base_rows)


def match_features(base: Features, target: Features, config: MatchingConfig) -> Correspondences:
    """Find for each target keypoint the base keypoint with the nearest descriptor, of the same spacing and ranges."""
    none = np.zeros(0, dtype=np.int64)
    if not len(base) or not len(target):
        return Correspondences(none, none, np.zeros(0))
    distance, base_rows = _nearest(base.descriptors, target.descriptors)
    is_kept = distance <= np.quantile(distance, config.kept_share)
    target_rows = np.flatnonzero(is_kept).astype(np.int64)
    return Correspondences(base_rows[is_kept], target_rows, distance[is_kept])


def _nearest(among: Matrix, wanted: Matrix) -> tuple[Scalars, Indices]:
    """Distance and row of each nearest descriptor."""
    # Matrix products: in 90 dimensions a k-d tree visits nearly every point, which is ten times slower.
    rows = np.zeros(len(wanted), dtype=np.int64)
    half_norm2 = (among**2).sum(axis=1) / 2
    step = max(_PAIRS_AT_ONCE // len(among), 1)
    for start in range(0, len(wanted), step):
        part = slice(start, start + step)
        rows[part] = (half_norm2 - wanted[part] @ among.T).argmin(axis=1)
    return np.linalg.norm(among[rows] - wanted, axis=1), rows
