# SPDX-License-Identifier: BSD-3-Clause
"""What to leave out of a survey to see how well the rest predicts it, and how far its field reaches."""

from itertools import pairwise

import numpy as np
from scipy.spatial import cKDTree

from magmatch.threads import side_by_side, slices
from magmatch.typing import Indices, Mask, Matrix, Points, Scalars, Vectors

# A squared-exponential potential's field differs from itself one lengthscale away by this share of its variance.
SHARE_AT_LENGTHSCALE = 0.6
SMALLEST_STRUCTURE = 0.1

# Size of stretches that are left out, and how many of how many groups of parts are.
STRETCH_IN_LENGTHSCALES, STRETCH_IN_EXTENTS = 4.0, 0.25
N_GROUPS, FOLDS = 5, (1, 3)

# Samples of a large survey that are asked how far they are from the places chosen so far.
MOST_CANDIDATES = 20_000
# Neighbours that tell how densely samples lie, the factor from their distance to the side of a cube that holds one
# sample (of samples anywhere in a volume), and how many samples are asked.
N_DENSITY, SIDE_OF_A_CUBE, MOST_ASKED = 8, 0.8, 1000


def typical_length(points: Points, field: Vectors) -> float:
    """Distance at which field vectors have lost most of their likeness: where the variogram reaches 60 %."""
    n = len(points)
    extent = float(np.linalg.norm(np.ptp(points, axis=0)))
    if extent == 0 or n < 3:
        return 0.0
    anchors = np.unique(np.linspace(0, n - 1, min(n, 400)).astype(np.int64))
    # Neighbours of rank 1, 2, 4, ...: pairs at all distances from the samples' spacing to the whole region.
    ranks = np.unique(np.minimum((2.0 ** np.arange(0, np.log2(n), 0.5)).astype(np.int64), n - 1))
    subset = points if n <= 20_000 else points[:: -(-n // 20_000)]
    values = field if n <= 20_000 else field[:: -(-n // 20_000)]
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


def sample_distance(points: Points) -> float:
    """Side of the cube that holds one sample, where most samples are."""
    asked = points[:: -(-len(points) // MOST_ASKED)]
    distance, _ = cKDTree(points).query(asked, k=[min(N_DENSITY + 1, len(points))])
    return SIDE_OF_A_CUBE * float(np.median(distance))


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


def has_path_order(points: Points) -> bool:
    """Whether consecutive samples are neighbours in space, as along a walk."""
    if len(points) < 3:
        return False
    step = np.median(np.linalg.norm(np.diff(points, axis=0), axis=1))
    spread = np.median(np.linalg.norm(points - np.median(points, axis=0), axis=1))
    return bool(step < 0.15 * spread)


def path_segments(points: Points, length: float) -> Indices:
    """Number the stretches of a path.

    Parameters
    ----------
    points : (n, 3) array, m
        In the order of the path.
    length : float, m
        Path length of one stretch, shortened where the path would not give ten.

    Returns
    -------
    (n,) int array
    """
    step = np.linalg.norm(np.diff(points, axis=0, prepend=points[:1]), axis=1)
    # Jumps between merged surveys are no path.
    along = np.cumsum(np.minimum(step, 10 * np.median(step) + length / 10))
    n_segments = max(10, int(along[-1] / max(length, 1e-12)))
    segment = (along / max(along[-1], 1e-300) * n_segments).astype(np.int64)
    return np.asarray(np.minimum(segment, n_segments - 1))


def path_stretches(points: Points, lengthscale: float) -> Indices:
    """Number the stretches of a path: long against the lengthscale, short against the region."""
    extent = float(np.ptp(points, axis=0).max())
    return path_segments(points, min(STRETCH_IN_LENGTHSCALES * lengthscale, STRETCH_IN_EXTENTS * extent))


def folds_of(number: Indices, others: bool = False) -> list[Mask]:
    """What to leave out, one set at a time: two of five groups of parts.

    Parameters
    ----------
    number : (n,) int array
        Which part each sample is in.
    others : bool
        The three other groups instead.

    Returns
    -------
    list of (n,) bool arrays
        Only sets that leave something out and something in.
    """
    groups = [k for k in range(N_GROUPS) if (k in FOLDS) != others]
    return [fold for fold in (number % N_GROUPS == k for k in groups) if fold.any() and not fold.all()]


def space_blocks(points: Points, size: float, rng: np.random.Generator) -> Indices:
    """Number the cubes that hold samples, at random."""
    cube = np.floor((points - points.min(axis=0)) / size).astype(np.int64)
    _, block = np.unique(cube, axis=0, return_inverse=True)
    return np.asarray(rng.permutation(int(block.max()) + 1)[block.reshape(-1)], dtype=np.int64)


def choose_part(points: Points, n_samples: int, n_places: int) -> Mask:
    """Samples around a few places far from one another.

    Parameters
    ----------
    points : (n, 3) array, m
    n_samples : int
        About how many to take.
    n_places : int
        Over how many places.

    Returns
    -------
    (n,) bool array
    """
    is_chosen = np.zeros(len(points), dtype=bool)
    first = int(np.argmin(((points - np.median(points, axis=0)) ** 2).sum(axis=1)))
    distance = ((points - points[first]) ** 2).sum(axis=1)
    for _ in range(n_places):
        nearest = np.argpartition(distance, min(n_samples // n_places, len(points) - 1))
        is_chosen[nearest[: max(1, n_samples // n_places)]] = True
        chosen = points[is_chosen]
        # Next: a place further from what was chosen than most, so that corners do not stand for the whole.
        candidates = points[:: max(1, len(points) // MOST_CANDIDATES)]
        away = cKDTree(chosen).query(candidates)[0]
        centre = int(np.argsort(away, kind="stable")[int(0.75 * len(candidates))])
        distance = ((points - candidates[centre]) ** 2).sum(axis=1)
    return is_chosen
