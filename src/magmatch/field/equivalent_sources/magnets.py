# SPDX-License-Identifier: BSD-3-Clause
"""Compact magnets near the samples: where dipoles explain most of a field that is otherwise smooth.

No basis of bounded size can represent the field of a magnet a few centimetres away, yet six numbers describe it.
Magnets are found one by one, each where it explains most of the residual, and all positions are refined together.
"""

import numpy as np
from scipy.spatial import cKDTree

from magmatch.geometry import DIRECTIONS, OCTAHEDRON
from magmatch.typing import Indices, Matrix, Points, Scalars, Vectors

# A magnet as charges on the corners of an octahedron and in its middle, of this size in its distance from the
# samples: so its moment, and where it stands exactly, are left open.
_CLUSTER, _CLUSTER_SIZE = np.vstack([OCTAHEDRON, np.zeros(3)]), 0.2

_FEWEST_SAMPLES, _MOST_SAMPLES, _MOST_MAGNETS = 40, 1500, 32
# Where a further one is looked for: around so many samples of large residuals, seen by so many neighbours each, in
# the directions to the neighbours of a cube and at so many distances.
_ANCHORS, _WITNESSES, _DISTANCES = 12, 80, 5
# A magnet costs six numbers; they must be worth so many times their number. Whether it stays is asked again.
_LEAST_WORTH = 2.0
_STEPS, _LARGEST_STEP, _SETTLED = 8, 0.3, 1e-4


def magnet_charges(points: Points, field: Vectors, reach: float) -> tuple[Points, Indices, Scalars]:
    """Clusters of charges (k, 3) for magnets near the samples; of each its magnet and its largest size, T m^2."""
    at, moments = find_magnets(points, field, reach)
    away = np.asarray(cKDTree(points).query(at)[0]).reshape(-1)
    at, moments, size = at[away < reach], moments[away < reach], _CLUSTER_SIZE * away[away < reach]
    charges = (at[:, None] + size[:, None, None] * _CLUSTER).reshape(-1, 3)
    strength = np.linalg.norm(moments, axis=1) / size
    return charges, np.repeat(np.arange(len(at)), len(_CLUSTER)), np.repeat(strength, len(_CLUSTER))


def find_magnets(points: Points, field: Vectors, reach: float) -> tuple[Points, Vectors]:
    """Positions (m) and moments (T m^3) of dipoles beside a field that changes linearly: (k, 3) each."""
    some = slice(None, None, -(-len(points) // _MOST_SAMPLES))
    x, y = points[some] - points.mean(axis=0), field[some]
    positions, moments, tree = np.zeros((0, 3)), np.zeros((0, 3)), cKDTree(x)
    nearest = float(np.median(np.asarray(tree.query(x, k=2)[0])[:, 1]))
    if len(x) < _FEWEST_SAMPLES or not nearest > 0:
        return positions, moments
    residual = _solved(x, y, positions)[2]
    while len(positions) < _MOST_MAGNETS:
        candidate = _candidate(x, residual, tree, nearest, reach)
        tried = _refined(x, y, np.concatenate([positions, candidate[None]]), tree, nearest)
        gain = y.size * np.log((residual**2).sum() / (tried[2] ** 2).sum()) / _LEAST_WORTH
        if not gain > 6 * np.log(y.size):
            break
        positions, moments, residual = tried
    return positions + points.mean(axis=0), moments


def _candidate(x: Points, residual: Vectors, tree: cKDTree, nearest: float, reach: float) -> Points:
    """Find the place where one dipole explains most of the residuals around it."""
    order = np.argsort(-(residual**2).sum(axis=1), kind="stable")
    anchors = order[:: max(1, len(order) // (10 * _ANCHORS))][:_ANCHORS]
    offsets = (np.geomspace(nearest, reach, _DISTANCES)[:, None, None] * DIRECTIONS).reshape(-1, 3)
    at = x[anchors][:, None] + offsets
    rows = np.asarray(tree.query(x[anchors], k=min(_WITNESSES, len(x)))[1]).reshape(len(anchors), -1)
    gram, u = moment_equations(x, residual, rows, at)
    gains = (u * np.linalg.solve(gram, u[..., None])[..., 0]).sum(axis=-1)
    gains[np.asarray(tree.query(at)[0]) <= 0.5 * nearest] = -np.inf
    return np.asarray(at.reshape(-1, 3)[np.argmax(gains)])


def moment_equations(x: Points, residual: Vectors, rows: Indices, at: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Normal equations of one dipole's moment at each place (a, p, 3): sums over ``rows`` (a, w) of A^T A, A^T b.

    ``A = (3 r r^T / d^2 - I) / d^3``, whose square is ``3 r r^T / d^8 + I / d^6``.
    """
    r = x[rows][:, None] - at[:, :, None]
    # No witness stands where a dipole is tried that counts.
    inverse = 1 / np.maximum((r**2).sum(axis=-1), 1e-30)
    six, scaled = inverse**3, r * (inverse**2)[..., None]
    gram = 3 * np.swapaxes(scaled, -1, -2) @ scaled + six.sum(axis=-1)[..., None, None] * np.eye(3)
    b = residual[rows][:, None]
    along = 3 * inverse * (r * b).sum(axis=-1)
    return gram, (np.sqrt(six)[..., None] * (along[..., None] * r - b)).sum(axis=2)


def _refined(
    x: Points, y: Vectors, positions: Points, tree: cKDTree, nearest: float
) -> tuple[Points, Vectors, Vectors]:
    """Positions by damped Gauss-Newton steps, moments and residuals for them."""
    columns, weights, left = _solved(x, y, positions)
    damping = 1e-3
    for _ in range(_STEPS):
        moments = weights[8:].reshape(-1, 3)
        A = np.concatenate([columns, dipole_slopes(x, positions, moments)])
        H, scale = _scaled_gram(A)
        g = A @ left.ravel() / scale
        settled = True
        while damping < 1e4:
            step = (np.linalg.solve(H + damping * np.eye(len(H)), g) / scale)[len(columns) :].reshape(-1, 3)
            limit = _LARGEST_STEP * np.asarray(tree.query(positions)[0])
            step *= np.minimum(1, limit / np.maximum(np.linalg.norm(step, axis=1), 1e-300))[:, None]
            moved = positions + step
            tried = _solved(x, y, moved)
            before, after = (left**2).sum(), (tried[2] ** 2).sum()
            if after < before and np.asarray(tree.query(moved)[0]).min() > 0.5 * nearest:
                settled = after > (1 - _SETTLED) * before
                positions, damping = moved, damping / 5
                columns, weights, left = tried
                break
            damping *= 5
        if settled:
            break
    return positions, weights[8:].reshape(-1, 3), left


def _solved(x: Points, y: Vectors, positions: Points) -> tuple[Matrix, Scalars, Vectors]:
    """Columns (as rows), the moments (after the background's eight numbers) that fit best, and what they leave."""
    A = np.concatenate([_background(x), dipole_fields(x, positions)])
    H, scale = _scaled_gram(A)
    H[np.diag_indices_from(H)] += 1e-9
    w = np.linalg.solve(H, A @ y.ravel() / scale) / scale
    return A, w, y - (w @ A).reshape(-1, 3)


def _scaled_gram(A: Matrix) -> tuple[Matrix, Scalars]:
    """Products of rows brought to unit length, and their lengths: a survey in a line says nothing about some."""
    H = A @ A.T
    scale = np.sqrt(np.diag(H)) + 1e-300
    return H / scale / scale[:, None], scale


def _background(x: Points) -> Matrix:
    """A constant field and the five gradients that air allows: (8, 3 n)."""
    out = np.zeros((8, len(x), 3))
    out[range(3), :, range(3)] = 1.0
    for k, (a, b) in enumerate(((0, 1), (0, 2), (1, 2))):
        out[3 + k, :, a], out[3 + k, :, b] = x[:, b], x[:, a]
    for k, a in enumerate((0, 1)):
        out[6 + k, :, a], out[6 + k, :, 2] = x[:, a], -x[:, 2]
    return out.reshape(8, -1)


def dipole_fields(x: Points, positions: Points) -> Matrix:
    """Field of dipoles per unit of each moment: (3 k, 3 n)."""
    r = x - positions[:, None]
    inverse = 1 / (r**2).sum(axis=-1)[..., None, None]
    field = inverse**1.5 * (3 * inverse * r[..., :, None] * r[..., None, :] - np.eye(3))
    return np.asarray(field.transpose(0, 2, 1, 3).reshape(3 * len(positions), 3 * len(x)))


def dipole_slopes(x: Points, positions: Points, moments: Vectors) -> Matrix:
    """Derivatives of dipoles' fields by their positions: (3 k, 3 n)."""
    r = x - positions[:, None]
    inverse = 1 / (r**2).sum(axis=-1)[..., None, None]
    along, mixed = (r @ moments[..., None])[..., None], r[..., :, None] * moments[:, None, None, :]
    mixed = mixed + np.swapaxes(mixed, -1, -2) + along * np.eye(3)
    slopes = inverse**2.5 * (15 * along * inverse * r[..., :, None] * r[..., None, :] - 3 * mixed)
    return np.asarray(slopes.transpose(0, 2, 1, 3).reshape(3 * len(positions), 3 * len(x)))
