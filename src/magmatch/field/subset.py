# SPDX-License-Identifier: BSD-3-Clause
"""A representative part of a large survey, and the density of samples."""

import numpy as np
from scipy.spatial import cKDTree

from magmatch.typing import Mask, Points, Scalars, Vector3

# Samples of a large survey that are asked how far they are from the places chosen so far.
MOST_CANDIDATES = 20_000
# Squared distances that differ by less than this share of the survey's squared extent are equal.
ALIKE = 1e-9
# Neighbours that tell how densely samples lie, the factor from their distance to the side of a cube that holds one
# sample (of samples anywhere in a volume), and how many samples are asked.
N_DENSITY, SIDE_OF_A_CUBE, MOST_ASKED = 8, 0.8, 1000


def distinct_places(points: Points) -> Points:
    """Each place once, however many readings it has."""
    order = np.lexsort(points.T)
    is_new = np.append(True, (np.diff(points[order], axis=0) != 0).any(axis=1))
    return points[np.sort(order[is_new])]  # type: ignore[no-any-return]


def sample_distance(places: Points) -> float:
    """Side of the cube that holds one sample, where most of these places are."""
    asked = places[:: -(-len(places) // MOST_ASKED)]
    distance, _ = cKDTree(places).query(asked, k=[min(N_DENSITY + 1, len(places))])
    return SIDE_OF_A_CUBE * float(np.median(distance))


def choose_part(points: Points, n_samples: int, n_places: int) -> Mask:
    """About so many samples around a few places far from one another: (n,) bool."""
    is_chosen = np.zeros(len(points), dtype=bool)
    # One far fix does not blur all others.
    extent = np.diff(np.quantile(points, (0.05, 0.95), axis=0), axis=0)
    alike = ALIKE * float((extent**2).sum()) or 1.0

    def from_place(place: Vector3) -> Scalars:
        # Those equally far, as on a grid, are so whatever rounding says.
        return np.round(((points - place) ** 2).sum(axis=1) / alike)  # type: ignore[no-any-return]

    distance = from_place(points[int(np.argmin(from_place(np.median(points, axis=0))))])
    # Next: a place further from what was chosen than most, so that corners do not stand for the whole.
    candidates = points[:: max(1, len(points) // MOST_CANDIDATES)]
    for place in range(n_places):
        if place > 0:
            away = np.round(cKDTree(points[is_chosen]).query(candidates)[0] ** 2 / alike)
            centre = int(np.argsort(away, kind="stable")[int(0.75 * len(candidates))])
            distance = from_place(candidates[centre])
        nearest = np.argpartition(distance, min(n_samples // n_places, len(points) - 1))
        is_chosen[nearest[: max(1, n_samples // n_places)]] = True
    return is_chosen
