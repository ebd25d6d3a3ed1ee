# SPDX-License-Identifier: BSD-3-Clause
"""Rows of the least squares of a walk's poses, and how correlated residuals are whitened: compiled loops."""

import numpy as np

from magmatch.compiled import compiled
from magmatch.typing import Mask, Matrix, Points, Tensors

# A row: the residual, then its slopes with the pose.
N_COLUMNS = 7


def residual_rows(
    R: Tensors, y: np.ndarray, b: np.ndarray, values: tuple[Points, Tensors], known: Mask, strain: Matrix
) -> tuple[np.ndarray, np.ndarray]:
    """Residuals of h poses of n bins, with slopes; and slopes of the field with where the bins are.

    Parameters
    ----------
    R : (h, 3, 3) array
        Rotations, base from walk.
    y, b : (h, n, 3) arrays, m and T
        Bins about the walk's centre, and their field, walk's axes.
    values : (h n, 3) and (h n, 3, 3) arrays, T and T/m
        The map's field and gradient there, base model axes.
    known : (h, n) array of bool
        Where the map says anything; elsewhere rows are 0.
    strain : (h, n) array
        What rows are divided by.

    Returns
    -------
    rows : (h, n, 3, 7) array
        Residual ``b - R^T B``, T, and slopes ``[G [y]x - [b]x, -G]``, G the gradient in the walk's axes.
    slopes : (h, n, 3, 6) array
        ``[[b]x, G]``: what a turn and a shift of each bin do to its residual.
    """
    rows, slopes = np.empty((*known.shape, 3, N_COLUMNS)), np.empty((*known.shape, 3, 6))
    R, y, b, field, gradient = (np.ascontiguousarray(x) for x in (R, y, b, *values))
    _fill_rows(R, y, b, field, gradient, known, strain, rows, slopes, *np.zeros((2, 3, 3)))
    return rows, slopes


@compiled
def _fill_rows(R, y, b, field, gradient, known, strain, rows, slopes, bx, yx):  # type: ignore[no-untyped-def]
    h, n = known.shape
    for p in range(h):
        for i in range(n):
            _skew(b[p, i], bx)
            _skew(y[p, i], yx)
            at, row, slope = p * n + i, rows[p, i], slopes[p, i]
            told = 1.0 if known[p, i] else 0.0
            share = told / strain[p, i]
            for a in range(3):
                expected = 0.0
                for c in range(3):
                    expected += R[p, c, a] * field[at, c]
                    turned = 0.0
                    for d in range(3):
                        for e in range(3):
                            turned += R[p, d, a] * gradient[at, d, e] * R[p, e, c]
                    slope[a, c] = bx[a, c]
                    slope[a, 3 + c] = turned * told
                row[a, 0] = (b[p, i, a] - expected) * share
                for c in range(3):
                    moved = -bx[a, c]
                    for d in range(3):
                        moved += slope[a, 3 + d] * yx[d, c]
                    row[a, 1 + c] = moved * share
                    row[a, 4 + c] = -slope[a, 3 + c] * share


@compiled
def _skew(v, S):  # type: ignore[no-untyped-def]
    """Off the diagonal, which is 0."""
    S[0, 1], S[0, 2], S[1, 2] = -v[2], v[1], -v[0]
    S[1, 0], S[2, 0], S[2, 1] = v[2], -v[1], v[0]


@compiled
def whiten(L, rows):  # type: ignore[no-untyped-def]
    """Overwrite rows (h, n, k) by ``L^-1 rows``, L lower triangular (h, n, n)."""
    h, n, k = rows.shape
    for p in range(h):
        for i in range(n):
            for j in range(i):
                f = L[p, i, j]
                for c in range(k):
                    rows[p, i, c] -= f * rows[p, j, c]
            f = 1.0 / L[p, i, i]
            for c in range(k):
                rows[p, i, c] *= f


@compiled
def whiten_again(L, rows):  # type: ignore[no-untyped-def]
    """Overwrite rows (h, n) by ``L^-T rows``."""
    h, n = rows.shape
    for p in range(h):
        for j in range(n - 1, -1, -1):
            rows[p, j] /= L[p, j, j]
            f = rows[p, j]
            for i in range(j):
                rows[p, i] -= f * L[p, j, i]


@compiled
def add_alike(C, along, map_along, sd, nugget2):  # type: ignore[no-untyped-def]
    """Add what all components have alike to a covariance (h, n, n), or (h, 3 n, 3 n) bin by bin.

    Along the path: ``along + map_along * sd_i * sd_j``, and a variance of each bin's own.
    """
    h, n = sd.shape
    s = C.shape[1] // n
    for p in range(h):
        for i in range(n):
            for j in range(n):
                one = along[i, j] + map_along[i, j] * sd[p, i] * sd[p, j]
                if i == j:
                    one += nugget2
                for a in range(s):
                    C[p, s * i + a, s * j + a] += one


@compiled
def isolate(C, known):  # type: ignore[no-untyped-def]
    """Cut unknown bins off: unit variance, no covariance, so that they add nothing to any sum or determinant."""
    h, n = known.shape
    s = C.shape[1] // n
    for p in range(h):
        for i in range(s * n):
            for j in range(s * n):
                if not (known[p, i // s] and known[p, j // s]):
                    C[p, i, j] = 1.0 if i == j else 0.0
