# SPDX-License-Identifier: BSD-3-Clause
"""Compact magnets near the samples: where dipoles explain most of a field that is otherwise smooth.

No basis of bounded size can represent the field of a magnet a few centimetres away, yet six numbers describe it.
Magnets are found one by one, each where it explains most of the residual, and all positions are refined together.
"""

import numpy as np
from scipy.spatial import cKDTree

from magmatch.compiled import compiled
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
    offsets = (np.geomspace(nearest, reach, _DISTANCES)[:, None, None] * _DIRECTIONS).reshape(-1, 3)
    at = x[anchors][:, None] + offsets
    rows = np.asarray(tree.query(x[anchors], k=min(_WITNESSES, len(x)))[1]).reshape(len(anchors), -1)
    gram, u = moment_equations(x, residual, rows, at)
    gains = (u * np.linalg.solve(gram, u[..., None])[..., 0]).sum(axis=-1)
    gains[np.asarray(tree.query(at)[0]) <= 0.5 * nearest] = -np.inf
    return np.asarray(at.reshape(-1, 3)[np.argmax(gains)])


@compiled
def moment_equations(
    x: np.ndarray, residual: np.ndarray, rows: np.ndarray, at: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Normal equations of one dipole's moment at each place: sums of ``3 r r^T / d^8 + I / d^6`` and of A b."""
    gram, u = np.zeros((*at.shape, 3)), np.zeros(at.shape)
    for i in range(at.shape[0]):
        for j in range(at.shape[1]):
            G, v = gram[i, j], u[i, j]
            for row in rows[i]:
                r0, r1, r2 = x[row, 0] - at[i, j, 0], x[row, 1] - at[i, j, 1], x[row, 2] - at[i, j, 2]
                b = residual[row]
                # No witness stands where a dipole is tried that counts.
                inverse = 1.0 / max(r0 * r0 + r1 * r1 + r2 * r2, 1e-30)
                cube = inverse * np.sqrt(inverse)
                six, along = cube * cube, 3.0 * inverse * (r0 * b[0] + r1 * b[1] + r2 * b[2])
                eight = 3.0 * six * inverse
                G[0, 0] += eight * r0 * r0 + six
                G[1, 1] += eight * r1 * r1 + six
                G[2, 2] += eight * r2 * r2 + six
                G[0, 1] += eight * r0 * r1
                G[0, 2] += eight * r0 * r2
                G[1, 2] += eight * r1 * r2
                v[0] += cube * (along * r0 - b[0])
                v[1] += cube * (along * r1 - b[1])
                v[2] += cube * (along * r2 - b[2])
            G[1, 0], G[2, 0], G[2, 1] = G[0, 1], G[0, 2], G[1, 2]
    return gram, u


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


@compiled
def dipole_fields(x: np.ndarray, positions: np.ndarray) -> np.ndarray:
    """Field of dipoles per unit of each moment: (3 k, 3 n)."""
    out = np.empty((3 * len(positions), 3 * len(x)))
    for k in range(len(positions)):
        for i in range(len(x)):
            r = x[i] - positions[k]
            inverse = 1.0 / (r[0] ** 2 + r[1] ** 2 + r[2] ** 2)
            cube = inverse * np.sqrt(inverse)
            for a in range(3):
                for b in range(3):
                    out[3 * k + a, 3 * i + b] = cube * (3 * inverse * r[a] * r[b] - (1.0 if a == b else 0.0))
    return out


@compiled
def dipole_slopes(x: np.ndarray, positions: np.ndarray, moments: np.ndarray) -> np.ndarray:
    """Derivatives of dipoles' fields by their positions: (3 k, 3 n)."""
    out = np.empty((3 * len(positions), 3 * len(x)))
    for k in range(len(positions)):
        m = moments[k]
        for i in range(len(x)):
            r = x[i] - positions[k]
            inverse = 1.0 / (r[0] ** 2 + r[1] ** 2 + r[2] ** 2)
            along, five = r[0] * m[0] + r[1] * m[1] + r[2] * m[2], inverse * inverse * np.sqrt(inverse)
            for a in range(3):
                for b in range(3):
                    mixed = r[a] * m[b] + m[a] * r[b] + (along if a == b else 0.0)
                    out[3 * k + a, 3 * i + b] = five * (15 * along * inverse * r[a] * r[b] - 3 * mixed)
    return out
