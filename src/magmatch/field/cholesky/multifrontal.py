# SPDX-License-Identifier: BSD-3-Clause
"""Sparse Cholesky factor by dense fronts: factorisation, log-determinant, solves, half solves."""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt
from numba import njit
from scipy.linalg import blas

from magmatch.field.cholesky.blas import cholesky, divide_right_transposed, subtract_square
from magmatch.field.cholesky.cells import HALF_STENCIL
from magmatch.field.cholesky.nested_dissection import Elimination
from magmatch.field.cholesky.reserve import RESERVE
from magmatch.field.cholesky.stencil_matrix import StencilMatrix
from magmatch.threads import side_by_side, single_threaded

NOTHING = np.zeros((0, 0))


@dataclass(frozen=True, eq=False, slots=True)
class CholeskyFactor:
    """``A = L L^T`` in the order of an elimination.

    Attributes
    ----------
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
        return float(2 * sum(np.log(np.diagonal(L)).sum(dtype=np.float64) for L in self.pivots))

    @property
    def n_bytes(self) -> int:
        """Memory of the factor."""
        return sum(block.nbytes for block in (*self.pivots, *self.below))

    def solve(self, rhs: np.ndarray) -> np.ndarray:
        """``A^-1 rhs`` for one (m + 3,) or several (m + 3, k) right-hand sides."""
        columns = rhs.reshape(len(rhs), -1)
        z = np.asfortranarray(columns[self.elimination.unknown], dtype=self.precision)
        for front, L, X in zip(self.elimination.fronts, self.pivots, self.below, strict=True):
            if len(L):
                z[front.start : front.stop] = self._trsm(1.0, L, z[front.start : front.stop], lower=1)
                z[front.border] -= X @ z[front.start : front.stop]
        self._solve_transposed(z)
        return np.ascontiguousarray(z[self.elimination.position], dtype=np.float64).reshape(rhs.shape)

    def solve_half(self, rhs: np.ndarray) -> np.ndarray:
        """``L^-T rhs``, whose covariance is ``A^-1`` where rhs is white: (m + 3, k)."""
        z = np.asfortranarray(rhs.copy(), dtype=self.precision)
        self._solve_transposed(z)
        return np.ascontiguousarray(z[self.elimination.position], dtype=np.float64)

    def _solve_transposed(self, z: np.ndarray) -> None:
        """Overwrite z (in the order of elimination) with ``L^-T z``."""
        for front, L, X in zip(self.elimination.fronts[::-1], self.pivots[::-1], self.below[::-1], strict=True):
            if len(L):
                own = z[front.start : front.stop] - X.T @ z[front.border]
                z[front.start : front.stop] = self._trsm(1.0, L, own, lower=1, trans_a=1)

    @property
    def precision(self) -> np.dtype[np.floating]:
        """Of its entries."""
        return self.pivots[0].dtype

    @property
    def _trsm(self) -> Callable[..., np.ndarray]:
        return blas.dtrsm if self.precision == np.float64 else blas.strsm


@single_threaded
def factorise(
    elimination: Elimination, matrix: StencilMatrix, precision: npt.DTypeLike = np.float64
) -> CholeskyFactor:
    """Factorise a positive definite matrix.

    Parameters
    ----------
    elimination : Elimination
        Order and fronts for the matrix' cells.
    matrix : StencilMatrix
    precision : numpy type
        Of the factor.

    Returns
    -------
    CholeskyFactor

    Raises
    ------
    numpy.linalg.LinAlgError
        If the matrix is not positive definite; names the pivot.
    """
    pivots, below = _blocks(elimination, precision)
    root = len(elimination.fronts) - 1
    updates = [NOTHING] * len(elimination.fronts)

    def eliminate(fronts: range) -> None:
        row_at = np.full(len(elimination.node_index), -1, dtype=np.int32)
        for k in fronts:
            updates[k] = _eliminate(elimination, k, matrix, row_at, updates, pivots[k], below[k])

    side_by_side(eliminate, elimination.branches)
    eliminate(range(root, root + 1))
    return CholeskyFactor(elimination, pivots, below)


def _blocks(elimination: Elimination, precision: npt.DTypeLike) -> tuple[list[np.ndarray], list[np.ndarray]]:
    """Where a factor's pivots and what is below them are to lie: one piece of memory."""
    sizes = [(front.stop - front.start, len(front.border)) for front in elimination.fronts]
    memory = RESERVE.take(sum(n * (n + k) for n, k in sizes), 1, precision).ravel(order="K")
    pivots, below, start = [], [], 0
    for n, k in sizes:
        pivots.append(memory[start : start + n * n].reshape((n, n), order="F"))
        below.append(memory[start + n * n : start + n * (n + k)].reshape((k, n), order="F"))
        start += n * (n + k)
    return pivots, below


def _eliminate(
    e: Elimination,
    k: int,
    matrix: StencilMatrix,
    row_at: np.ndarray,
    updates: list[np.ndarray],
    A: np.ndarray,
    X: np.ndarray,
) -> np.ndarray:
    """Write a front's columns of the factor; gives what is left for its parent, uses up what its children left."""
    front, is_leaf = e.fronts[k], True
    entries = (matrix.stencil, matrix.border, matrix.corner)
    _assemble(front.unknowns, e.flat_nodes, e.shifts, row_at, *entries, A, X)
    S = RESERVE.take(len(X), len(X), A.dtype)
    for child, rows in zip(front.children, front.child_rows, strict=True):
        _extend_add(updates[child], rows, A, X, S, is_leaf)
        # Its memory serves the next front.
        updates[child], is_leaf = NOTHING, False
    failed = _factor_front(A, X, S, is_leaf)
    if failed:
        msg = f"matrix is not positive definite: pivot {front.start + failed} of {e.n_unknowns} fails"
        raise np.linalg.LinAlgError(msg)
    return S


@njit(cache=True, nogil=True)
def _assemble(unknowns, flat, shifts, row_at, stencil, border, corner, A, X):  # type: ignore[no-untyped-def]
    """Copy the matrix' own entries of a front's columns into its dense blocks, 0 elsewhere."""
    # Compiled loops go row by row; these lie column by column.
    A.T[:], X.T[:] = 0, 0
    nodes = unknowns[unknowns < len(stencil)]
    for row in range(len(nodes)):
        row_at[flat[nodes[row]]] = row
    _copy_stencils(nodes, flat, shifts, row_at, stencil, A, X)
    _copy_constant(unknowns, border, corner, A, X)
    row_at[flat[nodes]] = -1


@njit(cache=True, nogil=True)
def _copy_stencils(nodes, flat, shifts, row_at, stencil, A, X):  # type: ignore[no-untyped-def]
    """Entries between nodes, of which those that were eliminated before have no row."""
    n = len(A)
    for j in range(min(n, len(nodes))):
        for o in range(HALF_STENCIL):
            row = row_at[flat[nodes[j]] + shifts[HALF_STENCIL - 1 + o]]
            if row >= n:
                X[row - n, j] = stencil[nodes[j], o]
            elif row >= 0:
                A[max(row, j), min(row, j)] = stencil[nodes[j], o]
        # The front's own nodes on the other side meet this one on theirs.
        for o in range(1, HALF_STENCIL):
            row = row_at[flat[nodes[j]] + shifts[HALF_STENCIL - 1 - o]]
            if row >= n:
                X[row - n, j] = stencil[nodes[row], o]


@njit(cache=True, nogil=True)
def _copy_constant(unknowns, border, corner, A, X):  # type: ignore[no-untyped-def]
    """Entries of the constant, which comes last in every front."""
    n, m, first = len(A), len(border), len(unknowns) - 3
    for j in range(n):
        for c in range(max(0, unknowns[j] - m), 3):
            value = border[unknowns[j], c] if unknowns[j] < m else corner[c, unknowns[j] - m]
            if first + c < n:
                A[first + c, j] = value
            else:
                X[first + c - n, j] = value


@njit(cache=True, nogil=True)
def _extend_add(update, rows, A, X, S, is_first):  # type: ignore[no-untyped-def]
    """Add the lower triangle of a child's update, S being 0 before the first; rows ascend, so its order is kept."""
    n = A.shape[0]
    n_own = np.searchsorted(rows, n)
    if is_first:
        for j in range(len(S)):
            S[j:, j] = 0
    # Neighbours mostly stay neighbours: runs of rows are added as vectors.
    runs = _runs(rows, n_own)
    for j in range(len(rows)):
        q = rows[j]
        for r in range(len(runs) - 1):
            first, last = max(runs[r], j), runs[r + 1]
            if first >= last:
                continue
            to = rows[last - 1] + 1
            if last <= n_own:
                A[to - (last - first) : to, q] += update[first:last, j]
            elif j < n_own:
                X[to - (last - first) - n : to - n, q] += update[first:last, j]
            else:
                S[to - (last - first) - n : to - n, q - n] += update[first:last, j]


@njit(cache=True, nogil=True)
def _runs(rows: np.ndarray, n_own: int) -> np.ndarray:
    """Where runs of consecutive rows start, a new one with the first row of the border; then their end."""
    starts, count = np.empty(len(rows) + 1, dtype=np.int64), 0
    for i in range(len(rows)):
        if i in (0, n_own) or rows[i] != rows[i - 1] + 1:
            starts[count] = i
            count += 1
    starts[count] = len(rows)
    return starts[: count + 1]


@njit(cache=True, nogil=True)
def _factor_front(A: np.ndarray, X: np.ndarray, S: np.ndarray, is_leaf: bool) -> int:
    """Factor a front in place; the pivot that fails, 0 where none does."""
    if len(A) == 0:
        if is_leaf:
            S.T[:] = 0
        return 0
    failed = cholesky(A)
    if failed == 0 and len(X):
        divide_right_transposed(A, X)
        subtract_square(X, S, not is_leaf)
    return failed
