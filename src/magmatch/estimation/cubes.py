# SPDX-License-Identifier: BSD-3-Clause
"""Points grouped by the cubes of a lattice: thinning, and sums per cube."""

import numpy as np

from magmatch.estimation.limits import COARSER, MOST_POINTS
from magmatch.typing import Indices, Matrix, Points

# Three lattice coordinates are packed into one integer, so many values a side (the hash of a larger place may
# collide, which only merges two far cubes).
_SIDE = int(np.cbrt(np.iinfo(np.int64).max))
# Share of the correlation length at which a field is sampled.
SAMPLING = 0.25


def cube_keys(points: Points, side: float) -> Indices:
    """One integer per point, equal for points of one cube."""
    i, j, k = (np.floor(points / side).astype(np.int64).T + _SIDE // 2) % _SIDE
    return np.asarray((i * _SIDE + j) * _SIDE + k)


def even_choice(n: int, limit: int) -> Indices:
    """Rows of n, at most as many as the limit and evenly spread, the first and the last among them."""
    return np.unique(np.linspace(0, n - 1, min(n, limit)).astype(np.int64))


def thin(points: Points, distance: float, limit: int = MOST_POINTS) -> Indices:
    """Rows of the first point in each cube: an even choice whatever the order of the points."""
    while True:
        _, first = np.unique(cube_keys(points, distance), return_index=True)
        if len(first) <= limit:
            return np.sort(first).astype(np.int64)
        distance *= COARSER


def sum_by_cube(rows: Matrix, points: Points, side: float) -> Matrix:
    """Rows added up over the cubes their points fall into, one row per occupied cube."""
    _, index = np.unique(cube_keys(points, side), return_inverse=True)
    return np.stack([np.bincount(index, column) for column in rows.T], axis=1)
