# SPDX-License-Identifier: BSD-3-Clause
"""The distance over which a field changes, from the variogram of its samples."""

from itertools import pairwise

import numpy as np

from magmatch.threads import side_by_side, slices
from magmatch.typing import Indices, Matrix, Points, Scalars, Vectors

# A squared-exponential potential's field differs from itself one lengthscale away by this share of its variance.
SHARE_AT_LENGTHSCALE = 0.6
SMALLEST_STRUCTURE = 0.1


def typical_length(points: Points, field: Vectors) -> float:
    """Distance at which field vectors have lost most of their correlation: where the variogram reaches 60 %."""
    n = len(points)
    extent = float(np.linalg.norm(np.ptp(points, axis=0)))
    if extent == 0 or n < 3:
        return 0.0
    anchors = np.unique(np.linspace(0, n - 1, min(n, 400)).astype(np.int64))
    # Neighbours of rank 1, 2, 4, ...: pairs at all distances from the samples' spacing to the whole region.
    ranks = np.unique(np.minimum((2.0 ** np.arange(0, np.log2(n), 0.5)).astype(np.int64), n - 1))
    subset, values = (rows[:: -(-n // 20_000)] for rows in (points, field))
    ranks = ranks[ranks < len(subset)]
    found = side_by_side(lambda some: _neighbours(points[anchors[some]], subset, ranks), slices(len(anchors)))
    distance, other = (np.concatenate(part) for part in zip(*found, strict=True))
    half_square = 0.5 * ((values[other] - field[anchors][:, None]) ** 2).sum(axis=2)
    order = np.argsort(distance, axis=None)
    d, g = distance.ravel()[order], half_square.ravel()[order]
    edges = np.linspace(0, len(d), 25).astype(np.int64)
    bins = [slice(a, b) for a, b in pairwise(edges) if b > a]
    d, g = np.array([d[k].mean() for k in bins]), np.array([_clipped_mean(g[k]) for k in bins])
    sill, nugget = _clipped_mean(((field - np.median(field, axis=0)) ** 2).sum(axis=1)), float(g[0])
    reached = np.flatnonzero(g >= nugget + SHARE_AT_LENGTHSCALE * max(sill - nugget, 0.0))
    # Without structure beyond the nugget, what there is changes slowly.
    has_structure = sill - nugget > SMALLEST_STRUCTURE * sill and len(reached) > 0
    length = d[reached[0]] if has_structure else extent / 4
    return float(np.clip(length, 1e-3 * extent, extent / 2))


def _neighbours(anchors: Points, points: Points, ranks: Indices) -> tuple[Matrix, Indices]:
    """Distance and number of the neighbours of some ranks, the anchors themselves being of rank 0: (a, r) each."""
    # Of neighbours equally far, as samples on a grid have, any one: the first would always lie on the same side.
    nudge = 1 + 1e-5 * np.random.default_rng(0).random(len(points), dtype=np.float32)
    centre = points.mean(axis=0)
    x, y = (anchors - centre).astype(np.float32), (points - centre).astype(np.float32)
    square = ((y**2).sum(axis=1) - 2 * x @ y.T + (x**2).sum(axis=1)[:, None]) * nudge
    # Sorted with the numbers in their lower half: numbers sort faster than their places.
    keys = np.maximum(square, 0).view(np.uint32).astype(np.uint64) << np.uint64(32) | np.arange(
        len(y), dtype=np.uint64
    )
    other = (np.sort(keys, axis=1)[:, ranks] & np.uint64(0xFFFFFFFF)).astype(np.int64)
    return np.linalg.norm(points[other] - anchors[:, None], axis=2), other


def _clipped_mean(squares: Scalars) -> float:
    """Mean of squares of which the largest twentieth counts no more than its least: a few spikes change little."""
    return float(np.minimum(squares, np.quantile(squares, 0.95)).mean())
