# SPDX-License-Identifier: BSD-3-Clause
"""The entries of the inverse that a field's covariance needs: those between nodes of one cell."""

import numpy as np

from magmatch.compiled import allocating, compiled
from magmatch.field.cholesky.blas import (
    LEFT,
    LOWER,
    NOT_UNIT,
    PLAIN,
    RIGHT,
    STRIP,
    TRANSPOSED,
    address_of,
    gemm,
    lacpy,
    lauum,
    symm,
    trmm,
    trtri,
)
from magmatch.field.cholesky.cells import FULL_STENCIL, HALF_STENCIL
from magmatch.field.cholesky.multifrontal import CholeskyFactor, flat, in_precision
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
    inherited: dict[int, np.ndarray] = {root: np.zeros(0, dtype=factor.precision)}

    def descend(fronts: range) -> None:
        row_of = np.full(e.n_unknowns, -1, dtype=np.int64)
        for k in reversed(fronts):
            front, L, X, Z22 = e.fronts[k], factor.pivots[k], factor.below[k], in_precision(inherited.pop(k))
            n, n_below = len(L), len(X)
            scratch, Z = (in_precision(np.empty((n + n_below) * n, factor.precision)) for _ in range(2))
            if n:
                _front_inverse(n, n_below, *in_precision(flat(L)), *in_precision(flat(X)), *Z22, *scratch, *Z)
            for child, rows in zip(front.children, front.child_rows, strict=True):
                inherited[child] = np.empty(len(rows) ** 2, factor.precision)
                _take_block(n, n_below, *Z, *Z22, rows, *in_precision(inherited[child]))
            _store(
                front.unknowns, n, e.cells.flat_nodes, e.cells.shifts, e.cells.node_index.ravel(), row_of, *Z,
                out.stencil, out.border, out.corner,
            )  # fmt: skip

    descend(range(root, root + 1))
    side_by_side(descend, e.branches)
    return out


@allocating
def _front_inverse(  # type: ignore[no-untyped-def]
    n_own, n_below, L_singles, L_doubles, X_singles, X_doubles, Z22_singles, Z22_doubles,
    scratch_singles, scratch_doubles, Z_singles, Z_doubles,
):  # fmt: skip
    """Write the inverse among a front's own unknowns (lower triangle), then that between its border and them."""
    is_single = len(L_singles) > 0
    size = 4 if is_single else 8
    L, X = (
        (address_of(L_singles), address_of(X_singles))
        if is_single
        else (address_of(L_doubles), address_of(X_doubles))
    )
    Z22 = address_of(Z22_singles) if is_single else address_of(Z22_doubles)
    inverse = address_of(scratch_singles) if is_single else address_of(scratch_doubles)
    Z11 = address_of(Z_singles) if is_single else address_of(Z_doubles)
    W, Z21 = inverse + size * n_own * n_own, Z11 + size * n_own * n_own
    n, m, info = np.int32(n_own), np.int32(n_below), np.zeros(1, np.int32)
    lacpy(is_single, LOWER, n, n, L, n, inverse, n)
    trtri(is_single, LOWER, NOT_UNIT, n, inverse, n, info)
    lacpy(is_single, LOWER, n, n, inverse, n, Z11, n)
    lauum(is_single, LOWER, n, Z11, n, info)
    if n_below == 0:
        return
    lacpy(is_single, PLAIN, m, n, X, m, W, m)
    trmm(is_single, RIGHT, LOWER, PLAIN, NOT_UNIT, m, n, 1.0, inverse, n, W, m)
    symm(is_single, LEFT, LOWER, m, n, -1.0, Z22, m, W, m, 0.0, Z21, m)
    # Minus W^T (-Z22 W), strip by strip; above the diagonal anything may be left.
    for j in range(0, n_own, STRIP):
        rows, columns, start = np.int32(n_own - j), np.int32(min(STRIP, n_own - j)), size * j * n_below
        gemm(
            is_single, TRANSPOSED, PLAIN, rows, columns, m, -1.0, W + start, m, Z21 + start, m,
            1.0, Z11 + size * j * (n_own + 1), n,
        )  # fmt: skip


@compiled
def _take_block(  # type: ignore[no-untyped-def]
    n, n_below, Z_singles, Z_doubles, Z22_singles, Z22_doubles, rows, block_singles, block_doubles
):  # fmt: skip
    """Copy the lower triangle of some rows and columns of a front's inverse; rows ascend."""
    size, is_single = len(rows), len(block_singles) > 0
    for j in range(size):
        q = rows[j]
        for i in range(j, size):
            p = rows[i]
            if q >= n:
                at = (q - n) * n_below + p - n
                if is_single:
                    block_singles[j * size + i] = Z22_singles[at]
                else:
                    block_doubles[j * size + i] = Z22_doubles[at]
            else:
                at = q * n + p if p < n else n * n + q * n_below + p - n
                if is_single:
                    block_singles[j * size + i] = Z_singles[at]
                else:
                    block_doubles[j * size + i] = Z_doubles[at]


@compiled
def _store(unknowns, n, flat, shifts, lookup, row_of, singles, doubles, stencil, border, corner):  # type: ignore[no-untyped-def]
    """Copy the inverse among a front's own unknowns, and between its border and them, to where it is kept."""
    m, n_below, is_single = stencil.shape[0], len(unknowns) - n, len(singles) > 0
    for row in range(len(unknowns)):
        row_of[unknowns[row]] = row
    for j in range(n):
        i = unknowns[j]
        for c in range(max(0, i - m), 3):
            row = row_of[m + c]
            at = j * n + row if row < n else n * n + j * n_below + row - n
            value = singles[at] if is_single else doubles[at]
            if i < m:
                border[i, c] = value
            else:
                corner[c, i - m] = value
                corner[i - m, c] = value
        if i >= m:
            continue
        for o in range(FULL_STENCIL):
            q = lookup[flat[i] + shifts[o]]
            if q < 0 or row_of[q] < j:
                continue
            row = row_of[q]
            at = j * n + row if row < n else n * n + j * n_below + row - n
            value = singles[at] if is_single else doubles[at]
            if o >= HALF_STENCIL - 1:
                stencil[i, o - HALF_STENCIL + 1] = value
            else:
                stencil[q, HALF_STENCIL - 1 - o] = value
    for row in range(len(unknowns)):
        row_of[unknowns[row]] = -1
