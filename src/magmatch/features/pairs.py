# SPDX-License-Identifier: BSD-3-Clause
"""Rotation invariants of a pair of points, and the rotation between two such pairs.

A walk along a line knows its field but not the field's gradient across the line, so a single point carries no frame.
Two points do: the vector between them and the two field vectors.
"""

import numpy as np

from magmatch.features.wahba import best_rotations
from magmatch.typing import Matrix, Points, Scalars, Tensors, Vectors


def pair_invariants(first: Points, second: Points, field_first: Vectors, field_second: Vectors) -> Matrix:
    """Seven numbers per pair of points that no rigid motion of the survey changes: (n, 7).

    ``d`` (m), ``|B_i|``, ``|B_j|``, ``|B_i - B_j|``, ``B_i.u``, ``B_j.u`` (T) and the signed volume
    ``u.(B_i x B_j) / sqrt(|B_i| |B_j|)`` (T), u the unit vector from the first point to the second.
    """
    u = second - first
    d = np.linalg.norm(u, axis=1)
    u = u / np.maximum(d, np.finfo(float).tiny)[:, None]
    norm_first, norm_second = np.linalg.norm(field_first, axis=1), np.linalg.norm(field_second, axis=1)
    volume = np.einsum("ni,ni->n", u, np.cross(field_first, field_second))
    return np.stack(
        [
            d,
            norm_first,
            norm_second,
            np.linalg.norm(field_first - field_second, axis=1),
            np.einsum("ni,ni->n", field_first, u),
            np.einsum("ni,ni->n", field_second, u),
            volume / np.maximum(np.sqrt(norm_first * norm_second), np.finfo(float).tiny),
        ],
        axis=1,
    )


def whiten_pairs(invariants: Matrix, sd_position: float, sd_field: float, field_norm: float) -> Matrix:
    """Pair invariants in units of their uncertainty, so that distances between rows are comparable: (n, 7).

    `field_norm` (T) is the typical strength of the field, which turns an uncertain direction of u into an uncertain
    ``B.u``. One number for all pairs keeps equal pairs at distance zero.
    """
    d = invariants[:, 0]
    sd_along = np.sqrt(sd_field**2 + (field_norm * _direction_sd(d, sd_position)) ** 2)
    scale = np.empty_like(invariants)
    scale[:, 0] = np.sqrt(2) * sd_position
    scale[:, 1:3] = sd_field
    scale[:, 3] = np.sqrt(2) * sd_field
    scale[:, 4:6] = sd_along[:, None]
    scale[:, 6] = np.sqrt(2) * sd_field
    return np.asarray(invariants / scale)


def align_pairs(
    base: tuple[Vectors, Vectors, Vectors],
    target: tuple[Vectors, Vectors, Vectors],
    distance: Scalars,
    sd_position: float,
    sd_field: float,
) -> Tensors:
    """Rotations ``R_base_target`` that best turn target pairs onto base pairs (Wahba's problem, weighted): (n, 3, 3).

    A pair is the vector between the points (m) and the field at the first and at the second (T).
    """
    strength = np.linalg.norm(target[1], axis=1) + np.linalg.norm(target[2], axis=1)
    field_weight = (strength / (2 * sd_field)) ** 2
    weights = (_direction_sd(distance, sd_position) ** -2, field_weight, field_weight)
    sides = (tuple(map(np.ascontiguousarray, side)) for side in (base, target))
    return np.asarray(best_rotations(*sides, weights))


def _direction_sd(distance: Scalars, sd_position: float) -> Scalars:
    """Uncertainty of the direction between two points, rad."""
    return np.asarray(np.sqrt(2) * sd_position / np.maximum(distance, 2 * sd_position))
