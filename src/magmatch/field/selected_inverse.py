# SPDX-License-Identifier: BSD-3-Clause
"""The entries of the inverse that a field's covariance needs: those between nodes of one cell."""

import numpy as np
from numba import njit
from scipy.linalg import blas, lapack

from magmatch.field.cells import FULL_STENCIL, HALF_STENCIL
from magmatch.field.multifrontal import CholeskyFactor, clear_rows, place_rows
from magmatch.field.stencil_matrix import StencilMatrix


def selected_inverse(factor: CholeskyFactor) -> StencilMatrix:
    """Exact entries of ``A^-1`` on the stencil, from the root of the elimination down.

    With a front's factor ``[L; X]`` and the inverse Z22 among its border (known from its parent),
    ``W = X L^-1``, ``Z21 = -Z22 W``, ``Z11 = L^-T L^-1 + W^T Z22 W``.

    Parameters
    ----------
    factor : CholeskyFactor

    Returns
    -------
    StencilMatrix
        Right wherever two unknowns share an active cell (or one is the constant); 0 elsewhere.
    """
    e = factor.elimination
    out = StencilMatrix.zeros(e.n_unknowns - 3)
    row_of = np.full(e.n_unknowns, -1, dtype=np.int64)
    inherited: dict[int, np.ndarray] = {len(e.fronts) - 1: np.zeros((0, 0), order="F")}
    for k in range(len(e.fronts) - 1, -1, -1):
        front = e.fronts[k]
        Z = _front_inverse(factor.pivots[k], factor.below[k], inherited.pop(k))
        for child, rows in zip(front.children, front.child_rows, strict=True):
            inherited[child] = _block(Z, rows)
        place_rows(front, row_of)
        _store(
            front.start, front.stop, e.unknown, e.position, e.flat_nodes, e.shifts, e.node_index, row_of, Z,
            out.stencil, out.border, out.corner,
        )  # fmt: skip
        clear_rows(front, row_of)
    return out


def _front_inverse(L: np.ndarray, X: np.ndarray, Z22: np.ndarray) -> np.ndarray:
    """Lower triangle of the inverse over a front's unknowns and its border."""
    n, n_border = len(L), len(Z22)
    Z = np.empty((n + n_border, n + n_border), order="F")
    Z[n:, n:] = Z22
    if n == 0:
        return Z
    L_inverse = lapack.dtrtri(L, lower=1)[0]
    Z11 = blas.dsyrk(1.0, L_inverse, trans=1, lower=1)
    if n_border:
        W = blas.dtrmm(1.0, L_inverse, X, side=1, lower=1)
        Z21 = blas.dsymm(-1.0, Z22, W, lower=1)
        Z11 = blas.dgemm(-1.0, W, Z21, trans_a=1, beta=1.0, c=Z11, overwrite_c=1)
        Z[n:, :n] = Z21
    Z[:n, :n] = Z11
    return Z


@njit(cache=True)
def _block(Z: np.ndarray, rows: np.ndarray) -> np.ndarray:
    """Lower triangle of a block of Z, column by column."""
    n = len(rows)
    block = np.zeros((n, n)).T
    for j in range(n):
        for i in range(j, n):
            block[i, j] = Z[rows[i], rows[j]]
    return block


@njit(cache=True)
def _store(start, stop, unknown, position, flat, shifts, lookup, row_of, Z, stencil, border, corner):  # type: ignore[no-untyped-def]
    m = stencil.shape[0]
    for j in range(stop - start):
        i = unknown[start + j]
        if i >= m:
            for c in range(i - m, 3):
                value = Z[row_of[position[m + c]], j]
                corner[c, i - m] = value
                corner[i - m, c] = value
            continue
        for o in range(FULL_STENCIL):
            q = lookup[flat[i] + shifts[o]]
            if q < 0 or position[q] < start + j:
                continue
            row = row_of[position[q]]
            if row < 0:
                continue
            if o >= HALF_STENCIL - 1:
                stencil[i, o - HALF_STENCIL + 1] = Z[row, j]
            else:
                stencil[q, HALF_STENCIL - 1 - o] = Z[row, j]
        for c in range(3):
            border[i, c] = Z[row_of[position[m + c]], j]
