# SPDX-License-Identifier: BSD-3-Clause
"""`match`: keypoints of two maps with similar descriptors."""

from dataclasses import dataclass

import numpy as np
from pydantic import Field

from magmatch.settings import Settings
from magmatch.typing import Indices, Matrix, Scalars

# Pairs of descriptors compared at once: bounds memory.
_PAIRS_AT_ONCE = 4_000_000


class MatchingConfig(Settings):
    """Which nearest neighbours in descriptor space are used."""

    # Share of the nearest neighbours, closest first, that is kept: the threshold adapts to noise and grid.
    kept_share: float = Field(default=0.5, gt=0, le=1)
    # Or the largest distance of descriptors, as published (no number is printed).
    max_distance: float | None = Field(default=None, gt=0)


@dataclass(frozen=True, eq=False, slots=True)
class Matches:
    """Corresponding keypoints of two maps.

    Attributes
    ----------
    base_rows, target_rows : (c,) arrays of ints
        Keypoints of each map.
    distance : (c,) array
        Between their descriptors.
    """

    base_rows: Indices
    target_rows: Indices
    distance: Scalars

    def __len__(self) -> int:
        return len(self.base_rows)

    def __repr__(self) -> str:
        return f"Matches({len(self)})"


def match(base: Matrix, target: Matrix, config: MatchingConfig | None = None) -> Matches:
    """Find for each target keypoint the base keypoint with the nearest descriptor, and keep the closest.

    Parameters
    ----------
    base, target : (k, d) arrays
        Descriptors of both maps, made with one spacing and one range.
    config : MatchingConfig, optional
        Which neighbours are kept.

    Returns
    -------
    Matches
        Empty where either map has no keypoint.
    """
    config, none = config or MatchingConfig(), np.zeros(0, dtype=np.int64)
    if not len(base) or not len(target):
        return Matches(none, none, np.zeros(0))
    distance, base_rows = _nearest(base, target)
    limit = config.max_distance or float(np.quantile(distance, config.kept_share))
    is_kept = distance <= limit
    return Matches(base_rows[is_kept], np.flatnonzero(is_kept).astype(np.int64), distance[is_kept])


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
