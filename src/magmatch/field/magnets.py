# SPDX-License-Identifier: BSD-3-Clause
"""Compact magnets near the samples: where dipoles explain most of a field that is otherwise smooth.

A magnet some centimetres away has a field that no basis of bounded size follows, yet six numbers describe it. They
are found one after the other, each where it explains most of what is left, and all positions are refined together.
"""

import numpy as np
from scipy.spatial import cKDTree

from magmatch.typing import Indices, Matrix, Points, Scalars, Vectors

# A magnet as charges on the corners of an octahedron and in its middle, of this size in its distance from the
# samples: so its moment, and where it stands exactly, are left open.
_CLUSTER, _CLUSTER_SIZE = np.concatenate([np.eye(3), -np.eye(3), np.zeros((1, 3))]), 0.2

_FEWEST_SAMPLES, _MOST_SAMPLES, _MOST_MAGNETS = 40, 1500, 32
# Where a further one is looked for: around so many samples of large residuals, seen by so many neighbours each, in
# the directions to the neighbours of a cube and at so many distances.
_ANCHORS, _WITNESSES, _DISTANCES = 12, 80, 5
_DIRECTIONS = np.array([d for d in np.ndindex(3, 3, 3) if d != (1, 1, 1)]) - 1.0
_DIRECTIONS /= np.linalg.norm(_DIRECTIONS, axis=1, keepdims=True)
# A magnet costs six numbers; they must be worth so many times their number. Whether it stays is asked again.
_LEAST_WORTH = 2.0
_STEPS, _LARGEST_STEP, _SETTLED = 8, 0.3, 1e-4


def magnet_charges(points: Points, field: Vectors, reach: float) -> tuple[Points, Indices, Scalars]:
    """Clusters of charges that stand for magnets near the samples.

    Parameters
    ----------
    points : (n, 3) array, m
    field : (n, 3) array, T
    reach : float, m
        Magnets farther from all samples are left out.

    Returns
    -------
    charges : (k, 3) array, m
    group : (k,) int array
        Which magnet each stands for.
    strength : (k,) array, T m^2
        How large each may be.
    """
    at, moments = find_magnets(points, field, reach)
    away = np.asarray(cKDTree(points).query(at)[0]).reshape(-1)
    at, moments, size = at[away < reach], moments[away < reach], _CLUSTER_SIZE * away[away < reach]
    charges = (at[:, None] + size[:, None, None] * _CLUSTER).reshape(-1, 3)
    strength = np.linalg.norm(moments, axis=1) / size
    return charges, np.repeat(np.arange(len(at)), len(_CLUSTER)), np.repeat(strength, len(_CLUSTER))


def find_magnets(points: Points, field: Vectors, reach: float) -> tuple[Points, Vectors]:
    """Positions and moments of dipoles beside a field that changes linearly.

    Parameters
    ----------
    points : (n, 3) array, m
    field : (n, 3) array, T
    reach : float, m
        No magnet farther from the samples is looked for.

    Returns
    -------
    positions : (k, 3) array, m
    moments : (k, 3) array, T m^3
    """
    some = slice(None, None, -(-len(points) // _MOST_SAMPLES))
    x, y = points[some] - points.mean(axis=0), field[some]
    positions, moments, tree = np.zeros((0, 3)), np.zeros((0, 3)), cKDTree(x)
    nearest = float(np.median(np.asarray(tree.query(x, k=2)[0])[:, 1]))
    if len(x) < _FEWEST_SAMPLES or not nearest > 0:
        return positions, moments
    residual = _solved(x, y, positions)[1]
    while len(positions) < _MOST_MAGNETS:
        candidate = _candidate(x, residual, tree, nearest, reach)
        tried = _refined(x, y, np.concatenate([positions, candidate[None]]), tree, nearest)
        gain = y.size * np.log((residual**2).sum() / (tried[2] ** 2).sum()) / _LEAST_WORTH
        if not gain > 6 * np.log(y.size):
            break
        positions, moments, residual = tried
    return positions + points.mean(axis=0), moments


def _candidate(x: Points, residual: Vectors, tree: cKDTree, nearest: float, reach: float) -> Points:
    """Where one dipole explains most of the residuals around it."""
    order = np.argsort(-(residual**2).sum(axis=1), kind="stable")
    anchors = order[:: max(1, len(order) // (10 * _ANCHORS))][:_ANCHORS]
    offsets = (np.geomspace(nearest, reach, _DISTANCES)[:, None, None] * _DIRECTIONS).reshape(-1, 3)
    best, where = -np.inf, x[anchors[0]] + offsets[0]
    for anchor in anchors:
        at = x[anchor] + offsets
        at = at[np.asarray(tree.query(at)[0]) > 0.5 * nearest]
        rows = np.atleast_1d(tree.query(x[anchor], k=min(_WITNESSES, len(x)))[1])
        for p in at:
            A = _dipole(x[rows], p).reshape(-1, 3)
            u = A.T @ residual[rows].ravel()
            gain = float(u @ np.linalg.solve(A.T @ A, u))
            if gain > best:
                best, where = gain, p
    return np.asarray(where)


def _refined(
    x: Points, y: Vectors, positions: Points, tree: cKDTree, nearest: float
) -> tuple[Points, Vectors, Vectors]:
    """Positions by damped Gauss-Newton steps, moments and residuals for them."""
    weights, left = _solved(x, y, positions)
    damping = 1e-3
    for _ in range(_STEPS):
        moments = weights[8:].reshape(-1, 3)
        slopes = [_by_position(x, p, m).reshape(-1, 3) for p, m in zip(positions, moments, strict=True)]
        A = np.hstack([_columns(x, positions), *slopes])
        scale = np.linalg.norm(A, axis=0) + 1e-300
        A /= scale
        H, g = A.T @ A, A.T @ left.ravel()
        settled = True
        while damping < 1e4:
            step = (np.linalg.solve(H + damping * np.eye(len(H)), g) / scale)[8 + 3 * len(positions) :].reshape(-1, 3)
            limit = _LARGEST_STEP * np.asarray(tree.query(positions)[0])
            step *= np.minimum(1, limit / np.maximum(np.linalg.norm(step, axis=1), 1e-300))[:, None]
            moved = positions + step
            new_weights, new_left = _solved(x, y, moved)
            before, after = (left**2).sum(), (new_left**2).sum()
            if after < before and np.asarray(tree.query(moved)[0]).min() > 0.5 * nearest:
                settled = after > (1 - _SETTLED) * before
                positions, weights, left, damping = moved, new_weights, new_left, damping / 5
                break
            damping *= 5
        if settled:
            break
    return positions, weights[8:].reshape(-1, 3), left


def _solved(x: Points, y: Vectors, positions: Points) -> tuple[Scalars, Vectors]:
    """Moments (after the background's eight numbers) that fit best, and what they leave."""
    A = _columns(x, positions)
    # A survey in a line or a point says nothing about some gradients.
    scale = np.linalg.norm(A, axis=0) + 1e-300
    A /= scale
    H = A.T @ A
    H[np.diag_indices_from(H)] += 1e-9
    w = np.linalg.solve(H, A.T @ y.ravel())
    return w / scale, y - (A @ w).reshape(-1, 3)


def _columns(x: Points, positions: Points) -> Matrix:
    """Field of a constant, of the five gradients that air allows, and of the dipoles' moments: (3 n, 8 + 3 k)."""
    n = len(x)
    background = np.zeros((n, 3, 8))
    background[:, range(3), range(3)] = 1.0
    for k, (a, b) in enumerate(((0, 1), (0, 2), (1, 2))):
        background[:, a, 3 + k], background[:, b, 3 + k] = x[:, b], x[:, a]
    for k, a in enumerate((0, 1)):
        background[:, a, 6 + k], background[:, 2, 6 + k] = x[:, a], -x[:, 2]
    return np.hstack([background.reshape(3 * n, 8), *(_dipole(x, p).reshape(-1, 3) for p in positions)])


def _dipole(x: Points, position: np.ndarray) -> np.ndarray:
    """Field per unit moment: (n, 3, 3)."""
    r = x - position
    d = np.linalg.norm(r, axis=1)[:, None, None]
    return np.asarray(3 * r[:, :, None] * r[:, None, :] / d**5 - np.eye(3) / d**3)


def _by_position(x: Points, position: np.ndarray, moment: np.ndarray) -> np.ndarray:
    """Derivative of a dipole's field by its position: (n, 3, 3)."""
    r = x - position
    d, along = np.linalg.norm(r, axis=1)[:, None, None], (r @ moment)[:, None, None]
    mixed = r[:, :, None] * moment + moment[:, None] * r[:, None, :]
    return np.asarray(15 * along * r[:, :, None] * r[:, None, :] / d**7 - 3 * (mixed + along * np.eye(3)) / d**5)
