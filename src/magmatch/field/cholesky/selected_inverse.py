# SPDX-License-Identifier: BSD-3-Clause
"""The entries of the inverse that a field's covariance needs: those between nodes of one cell."""

import numpy as np
from numba import njit

from magmatch.field.cholesky.blas import (
    invert_triangle,
    minus_symmetric_product,
    multiply_right,
    square_transposed,
    subtract_transposed_product,
)
from magmatch.field.cholesky.cells import FULL_STENCIL, HALF_STENCIL
from magmatch.field.cholesky.multifrontal import CholeskyFactor
from magmatch.field.cholesky.reserve import RESERVE
from magmatch.field.cholesky.stencil_matrix import StencilMatrix
from magmatch.threads import side_by_side, single_threaded


@single_threaded
def selected_inverse(factor: CholeskyFactor) -> StencilMatrix:
    """Exact entries of ``A^-1`` on the stencil, from the root of the elimination down.

    With a front's factor ``[L; X]`` and the inverse Z22 among its border (known from its parent),
    ``W = X L^-1``, ``Z21 = -Z22 W``, ``Z11 = L^-T L^-1 + W^T Z22 W``.
    """
    e = factor.elimination
    out = StencilMatrix.zeros(e.n_unknowns - 3)
    root = len(e.fronts) - 1
    inherited: dict[int, np.ndarray] = {root: np.zeros((0, 0), dtype=factor.precision, order="F")}

    def descend(fronts: range) -> None:
        row_of = np.full(e.n_unknowns, -1, dtype=np.int64)
        for k in reversed(fronts):
            front, L, X, Z22 = e.fronts[k], factor.pivots[k], factor.below[k], inherited.pop(k)
            L_inverse, W, Z11, Z21 = (RESERVE.take(len(A), len(L), factor.precision) for A in (L, X, L, X))
            _front_inverse(L, X, Z22, L_inverse, W, Z11, Z21)
            for child, rows in zip(front.children, front.child_rows, strict=True):
                inherited[child] = RESERVE.take(len(rows), len(rows), factor.precision)
                _take_block(Z11, Z21, Z22, rows, inherited[child])
            _store(
                front.unknowns, e.flat_nodes, e.shifts, e.node_index, row_of, Z11, Z21,
                out.stencil, out.border, out.corner,
            )  # fmt: skip

    descend(range(root, root + 1))
    side_by_side(descend, e.branches)
    return out


@njit(cache=True, nogil=True)
def _front_inverse(
    L: np.ndarray,
    X: np.ndarray,
    Z22: np.ndarray,
    L_inverse: np.ndarray,
    W: np.ndarray,
    Z11: np.ndarray,
    Z21: np.ndarray,
) -> None:
    """Write the inverse among a front's own unknowns (lower triangle), and between its border and them."""
    if len(L) == 0:
        return
    # Transposed, since compiled loops go row by row and these lie column by column.
    L_inverse.T[:] = L.T
    invert_triangle(L_inverse)
    Z11.T[:] = L_inverse.T
    square_transposed(Z11)
    if len(X) == 0:
        return
    W.T[:] = X.T
    multiply_right(L_inverse, W)
    minus_symmetric_product(Z22, W, Z21)
    # Minus W^T (-Z22 W).
    subtract_transposed_product(W, Z21, Z11)


@njit(cache=True, nogil=True)
def _take_block(Z11: np.ndarray, Z21: np.ndarray, Z22: np.ndarray, rows: np.ndarray, block: np.ndarray) -> None:
    """Copy the lower triangle of some rows and columns of a front's inverse; rows ascend."""
    n, n_own = len(Z11), np.searchsorted(rows, len(Z11))
    for j in range(len(rows)):
        if j < n_own:
            for i in range(j, n_own):
                block[i, j] = Z11[rows[i], rows[j]]
            for i in range(n_own, len(rows)):
                block[i, j] = Z21[rows[i] - n, rows[j]]
        else:
            for i in range(j, len(rows)):
                block[i, j] = Z22[rows[i] - n, rows[j] - n]


@njit(cache=True, nogil=True)
def _store(unknowns, flat, shifts, lookup, row_of, Z11, Z21, stencil, border, corner):  # type: ignore[no-untyped-def]
    m, n = stencil.shape[0], len(Z11)
    for row in range(len(unknowns)):
        row_of[unknowns[row]] = row
    for j in range(n):
        i = unknowns[j]
        if i >= m:
            for c in range(i - m, 3):
                value = Z11[row_of[m + c], j]
                corner[c, i - m] = value
                corner[i - m, c] = value
            continue
        for o in range(FULL_STENCIL):
            q = lookup[flat[i] + shifts[o]]
            if q < 0 or row_of[q] < j:
                continue
            row = row_of[q]
            value = Z11[row, j] if row < n else Z21[row - n, j]
            if o >= HALF_STENCIL - 1:
                stencil[i, o - HALF_STENCIL + 1] = value
            else:
                stencil[q, HALF_STENCIL - 1 - o] = value
        for c in range(3):
            row = row_of[m + c]
            border[i, c] = Z11[row, j] if row < n else Z21[row - n, j]
    row_of[unknowns] = -1
