# SPDX-License-Identifier: BSD-3-Clause
"""Sparse Cholesky factor by dense fronts: factorisation, log-determinant, solves, half solves."""

from dataclasses import dataclass

import numpy as np
from numba import njit
from scipy.linalg import blas, lapack

from magmatch.field.cells import FULL_STENCIL, HALF_STENCIL
from magmatch.field.nested_dissection import Elimination, Front
from magmatch.field.stencil_matrix import StencilMatrix
from magmatch.threads import side_by_side


@dataclass(frozen=True, eq=False, slots=True)
class CholeskyFactor:
    """``A = L L^T`` in the order of an elimination.

    Attributes
    ----------
    elimination : Elimination
    pivots : list of (n, n) arrays
        Lower triangle of each front's own unknowns.
    below : list of (k, n) arrays
        Rows of L of each front's border.
    """

    elimination: Elimination
    pivots: list[np.ndarray]
    below: list[np.ndarray]

    @property
    def log_determinant(self) -> float:
        """Logarithm of the determinant of A."""
        return float(2 * sum(np.log(np.diagonal(L)).sum() for L in self.pivots))

    @property
    def n_bytes(self) -> int:
        """Memory of the factor."""
        return sum(block.nbytes for block in (*self.pivots, *self.below))

    def solve(self, rhs: np.ndarray) -> np.ndarray:
        """``A^-1 rhs`` for one (m + 3,) or several (m + 3, k) right-hand sides."""
        columns = rhs.reshape(len(rhs), -1)
        z = np.asfortranarray(columns[self.elimination.unknown])
        for front, L, X in zip(self.elimination.fronts, self.pivots, self.below, strict=True):
            if len(L):
                z[front.start : front.stop] = blas.dtrsm(1.0, L, z[front.start : front.stop], lower=1)
                z[front.border] -= X @ z[front.start : front.stop]
        self._solve_transposed(z)
        return np.ascontiguousarray(z[self.elimination.position]).reshape(rhs.shape)

    def solve_half(self, rhs: np.ndarray) -> np.ndarray:
        """``L^-T rhs``, whose covariance is ``A^-1`` where rhs is white: (m + 3, k)."""
        z = np.asfortranarray(rhs.copy())
        self._solve_transposed(z)
        return np.ascontiguousarray(z[self.elimination.position])

    def _solve_transposed(self, z: np.ndarray) -> None:
        """Overwrite z (in the order of elimination) with ``L^-T z``."""
        for front, L, X in zip(self.elimination.fronts[::-1], self.pivots[::-1], self.below[::-1], strict=True):
            if len(L):
                own = z[front.start : front.stop] - X.T @ z[front.border]
                z[front.start : front.stop] = blas.dtrsm(1.0, L, own, lower=1, trans_a=1)


def factorise(elimination: Elimination, matrix: StencilMatrix) -> CholeskyFactor:
    """Factorise a positive definite matrix.

    Parameters
    ----------
    elimination : Elimination
        Order and fronts for the matrix' cells.
    matrix : StencilMatrix

    Returns
    -------
    CholeskyFactor

    Raises
    ------
    numpy.linalg.LinAlgError
        If the matrix is not positive definite; names the pivot.
    """
    n_fronts = len(elimination.fronts)
    nothing = np.zeros((0, 0), order="F")
    pivots, below, updates = ([nothing] * n_fronts for _ in range(3))

    def eliminate(fronts: range) -> None:
        row_of = np.full(elimination.n_unknowns, -1, dtype=np.int64)
        for k in fronts:
            pivots[k], below[k], updates[k] = _eliminate(elimination, elimination.fronts[k], matrix, row_of, updates)

    side_by_side(eliminate, elimination.branches)
    eliminate(range(n_fronts - 1, n_fronts))
    return CholeskyFactor(elimination, pivots, below)


def _eliminate(
    elimination: Elimination, front: Front, matrix: StencilMatrix, row_of: np.ndarray, updates: list[np.ndarray]
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Factor of a front's own unknowns, of its border, and what is left for its parent; uses up its children's."""
    n, n_border = front.stop - front.start, len(front.border)
    A, X = np.zeros((n, n), order="F"), np.zeros((n_border, n), order="F")
    S = np.zeros((n_border, n_border), order="F")
    _assemble(elimination, front, matrix, row_of, A, X)
    for child, rows in zip(front.children, front.child_rows, strict=True):
        _extend_add(updates[child], rows, A, X, S)
        updates[child] = np.zeros((0, 0), order="F")
    if n:
        A, info = lapack.dpotrf(A, lower=1, clean=1, overwrite_a=1)
        if info:
            msg = f"matrix is not positive definite: pivot {front.start + info} of {elimination.n_unknowns} fails"
            raise np.linalg.LinAlgError(msg)
        if n_border:
            X = blas.dtrsm(1.0, A, X, side=1, lower=1, trans_a=1, overwrite_b=1)
            S = blas.dsyrk(-1.0, X, beta=1.0, c=S, lower=1, overwrite_c=1)
    return A, X, S


def _assemble(
    e: Elimination, front: Front, matrix: StencilMatrix, row_of: np.ndarray, A: np.ndarray, X: np.ndarray
) -> None:
    """Copy the matrix' own entries of a front's columns into its dense blocks."""
    place_rows(front, row_of)
    _copy_columns(
        front.start, e.unknown, e.position, e.flat_nodes, e.shifts, e.node_index,
        matrix.stencil, matrix.border, matrix.corner, row_of, A, X,
    )  # fmt: skip
    clear_rows(front, row_of)


def place_rows(front: Front, row_of: np.ndarray) -> None:
    """Write the row of each of a front's positions into a work array that is -1 elsewhere."""
    n = front.stop - front.start
    row_of[front.start : front.stop] = np.arange(n)
    row_of[front.border] = n + np.arange(len(front.border))


def clear_rows(front: Front, row_of: np.ndarray) -> None:
    """Undo `place_rows`."""
    row_of[front.start : front.stop] = -1
    row_of[front.border] = -1


@njit(cache=True, nogil=True)
def _copy_columns(start, unknown, position, flat, shifts, lookup, stencil, border, corner, row_of, A, X):  # type: ignore[no-untyped-def]
    n, m = A.shape[0], stencil.shape[0]
    for j in range(n):
        i = unknown[start + j]
        if i >= m:
            for c in range(i - m, 3):
                A[row_of[position[m + c]], j] = corner[c, i - m]
            continue
        for o in range(FULL_STENCIL):
            q = lookup[flat[i] + shifts[o]]
            if q < 0 or position[q] < start + j:
                continue
            row = row_of[position[q]]
            if row < 0:
                continue
            value = stencil[i, o - HALF_STENCIL + 1] if o >= HALF_STENCIL - 1 else stencil[q, HALF_STENCIL - 1 - o]
            if row < n:
                A[row, j] = value
            else:
                X[row - n, j] = value
        for c in range(3):
            row = row_of[position[m + c]]
            if row < n:
                A[row, j] = border[i, c]
            else:
                X[row - n, j] = border[i, c]


@njit(cache=True, nogil=True)
def _extend_add(update: np.ndarray, rows: np.ndarray, A: np.ndarray, X: np.ndarray, S: np.ndarray) -> None:
    """Add the lower triangle of a child's update; rows ascend, so its order is kept."""
    n = A.shape[0]
    for j in range(len(rows)):
        q = rows[j]
        for i in range(j, len(rows)):
            p = rows[i]
            if q >= n:
                S[p - n, q - n] += update[i, j]
            elif p >= n:
                X[p - n, q] += update[i, j]
            else:
                A[p, q] += update[i, j]
