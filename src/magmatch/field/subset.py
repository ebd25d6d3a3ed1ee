# SPDX-License-Identifier: BSD-3-Clause
"""A representative part of a large survey, and the density of samples."""

import numpy as np
from scipy.spatial import cKDTree

from magmatch.typing import Mask, Points

# Samples of a large survey that are asked how far they are from the places chosen so far.
MOST_CANDIDATES = 20_000
# Neighbours that tell how densely samples lie, the factor from their distance to the side of a cube that holds one
# sample (of samples anywhere in a volume), and how many samples are asked.
N_DENSITY, SIDE_OF_A_CUBE, MOST_ASKED = 8, 0.8, 1000


def sample_distance(points: Points) -> float:
    """Side of the cube that holds one sample, where most samples are."""
    asked = points[:: -(-len(points) // MOST_ASKED)]
    distance, _ = cKDTree(points).query(asked, k=[min(N_DENSITY + 1, len(points))])
    return SIDE_OF_A_CUBE * float(np.median(distance))


def choose_part(points: Points, n_samples: int, n_places: int) -> Mask:
    """About so many samples around a few places far from one another: (n,) bool."""
    is_chosen = np.zeros(len(points), dtype=bool)
    first = int(np.argmin(((points - np.median(points, axis=0)) ** 2).sum(axis=1)))
    distance = ((points - points[first]) ** 2).sum(axis=1)
    # Next: a place further from what was chosen than most, so that corners do not stand for the whole.
    candidates = points[:: max(1, len(points) // MOST_CANDIDATES)]
    for place in range(n_places):
        if place > 0:
            away = cKDTree(points[is_chosen]).query(candidates)[0]
            centre = int(np.argsort(away, kind="stable")[int(0.75 * len(candidates))])
            distance = ((points - candidates[centre]) ** 2).sum(axis=1)
        nearest = np.argpartition(distance, min(n_samples // n_places, len(points) - 1))
        is_chosen[nearest[: max(1, n_samples // n_places)]] = True
    return is_chosen
