# SPDX-License-Identifier: BSD-3-Clause
"""The entries of the inverse that a field's covariance needs: those between nodes of one cell."""

import numpy as np
from numba import njit
from scipy.linalg import blas, lapack

from magmatch.field.cells import FULL_STENCIL, HALF_STENCIL
from magmatch.field.multifrontal import CholeskyFactor, clear_rows, place_rows
from magmatch.field.stencil_matrix import StencilMatrix
from magmatch.threads import side_by_side

# Columns of a symmetric product that are computed at once: wide enough for BLAS, little above the diagonal is wasted.
STRIP = 64


class Workspace:
    """Matrices in memory that is used again: fresh pages would cost a fifth of the time.

    Parameters
    ----------
    size : int
        Numbers in the largest matrix.
    """

    def __init__(self, size: int) -> None:
        self._size = size
        self._free: list[np.ndarray] = []

    def take(self, n_rows: int, n_columns: int) -> np.ndarray:
        """Matrix with arbitrary content, column by column."""
        memory = self._free.pop() if self._free else np.empty(self._size)
        return memory[: n_rows * n_columns].reshape((n_rows, n_columns), order="F")

    def give_back(self, *matrices: np.ndarray) -> None:
        """Let others use the memory of matrices that came from `take`."""
        self._free.extend(m.base for m in matrices if m.base is not None)


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
    largest = max(len(f.border) * max(len(f.border), f.stop - f.start) for f in e.fronts)
    root = len(e.fronts) - 1
    inherited: dict[int, np.ndarray] = {root: np.zeros((0, 0), order="F")}

    def descend(fronts: range) -> None:
        row_of, space = np.full(e.n_unknowns, -1, dtype=np.int64), Workspace(max(1, largest))
        for k in reversed(fronts):
            front, Z22 = e.fronts[k], inherited.pop(k)
            Z11, Z21 = _front_inverse(factor.pivots[k], factor.below[k], Z22, space)
            for child, rows in zip(front.children, front.child_rows, strict=True):
                inherited[child] = space.take(len(rows), len(rows))
                _take_block(Z11, Z21, Z22, rows, inherited[child])
            place_rows(front, row_of)
            _store(
                front.start, e.unknown, e.position, e.flat_nodes, e.shifts, e.node_index, row_of, Z11, Z21,
                out.stencil, out.border, out.corner,
            )  # fmt: skip
            clear_rows(front, row_of)
            space.give_back(Z21, Z22)

    descend(range(root, root + 1))
    side_by_side(descend, e.branches)
    return out


def _front_inverse(L: np.ndarray, X: np.ndarray, Z22: np.ndarray, space: Workspace) -> tuple[np.ndarray, np.ndarray]:
    """Inverse among a front's own unknowns (lower triangle), and between its border and them."""
    n, n_border = len(L), len(Z22)
    if n == 0 or n_border == 0:
        return (lapack.dpotri(L, lower=1)[0] if n else L), space.take(n_border, n)
    L_inverse = lapack.dtrtri(L, lower=1)[0]
    Z11 = blas.dsyrk(1.0, L_inverse, trans=1, lower=1)
    W, Z21 = space.take(n_border, n), space.take(n_border, n)
    W[:] = X
    W = blas.dtrmm(1.0, L_inverse, W, side=1, lower=1, overwrite_b=1)
    Z21 = blas.dsymm(-1.0, Z22, W, lower=1, c=Z21, overwrite_c=1)
    # W^T Z22 W is symmetric: columns in strips, from the diagonal down.
    for j in range(0, n, STRIP):
        Z11[j:, j : j + STRIP] -= W[:, j:].T @ Z21[:, j : j + STRIP]
    space.give_back(W)
    return Z11, Z21


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
def _store(start, unknown, position, flat, shifts, lookup, row_of, Z11, Z21, stencil, border, corner):  # type: ignore[no-untyped-def]
    m, n = stencil.shape[0], len(Z11)
    for j in range(n):
        i = unknown[start + j]
        if i >= m:
            for c in range(i - m, 3):
                value = Z11[row_of[position[m + c]], j]
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
            value = Z11[row, j] if row < n else Z21[row - n, j]
            if o >= HALF_STENCIL - 1:
                stencil[i, o - HALF_STENCIL + 1] = value
            else:
                stencil[q, HALF_STENCIL - 1 - o] = value
        for c in range(3):
            row = row_of[position[m + c]]
            border[i, c] = Z11[row, j] if row < n else Z21[row - n, j]
