# SPDX-License-Identifier: BSD-3-Clause
"""Cholesky factor of a sparse matrix of 6 x 6 blocks, and blocks of its inverse (Takahashi).

Unknowns of a pose are coupled to those of another all together, so blocks are ordered and stored instead of numbers.
"""

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from scipy.sparse import bsr_array, coo_array, csc_array, diags_array
from scipy.sparse.linalg import splu

from magmatch.compiled import compiled
from magmatch.typing import Indices, Mask

SIDE = 6
# Conductance of each node of the network to the ground, over that of a resistor: small, so that currents reach far.
GROUNDED = 1e-6
# Where a block stands that is turned. A 0 that is written out would be a type of its own to the compiler.
ONLY = np.int64(0)


def sum_of_blocks(rows: Indices, columns: Indices, blocks: np.ndarray, n: int) -> bsr_array:
    """Lower half of a symmetric matrix of n x n blocks, from blocks (k, 6, 6) of its sum at or below the diagonal."""
    places, which = np.unique(rows * n + columns, return_inverse=True)
    starts = np.searchsorted(places, n * np.arange(n + 1))
    chosen = coo_array((np.ones(len(which)), (which, np.arange(len(which))))).tocsr()
    data = (chosen @ blocks.reshape(-1, SIDE * SIDE)).reshape(-1, SIDE, SIDE)
    return bsr_array((data, places % n, starts), shape=(SIDE * n, SIDE * n))


@dataclass(frozen=True, eq=False)
class BlockCholesky:
    """``A = L L^T`` in an order that keeps L sparse."""

    position: Indices  # (n,): place of each block of unknowns in that order
    starts: Indices  # (n + 1,): where each column of L begins, the diagonal first
    rows: Indices  # (m,): row of each block, ascending in a column
    L: np.ndarray  # (m, 6, 6)

    @classmethod
    def of(cls, A: bsr_array) -> "BlockCholesky":
        """Factor a positive definite matrix, of which the lower half is given."""
        n = A.shape[0] // SIDE
        i, j = np.repeat(np.arange(n), np.diff(A.indptr)), A.indices.astype(np.int64)
        position, starts, rows = _order(i, j, n)
        L = np.zeros((len(rows), SIDE, SIDE))
        at, is_above = _find(starts, rows, position[i], position[j])
        L[at] = _flipped(A.data, is_above)
        if not _factor(starts, rows, L, np.empty((1, SIDE, SIDE))):
            msg = "the graph does not determine all poses"
            raise np.linalg.LinAlgError(msg)
        return cls(position, starts, rows, L)

    @property
    def log_determinant(self) -> float:
        """Logarithm of the determinant of A."""
        return 2 * float(np.log(np.diagonal(self.L[self.starts[:-1]], axis1=1, axis2=2)).sum())

    def solve(self, rhs: np.ndarray) -> np.ndarray:
        """``A^-1 rhs`` for up to six right-hand sides: (n, 6, k)."""
        y, k = np.zeros((len(self.position), SIDE, SIDE)), rhs.shape[2]
        y[self.position, :, :k] = rhs
        _solve(self.starts, self.rows, self.L, y, np.empty((1, SIDE, SIDE)))
        return np.asarray(y[self.position, :, :k])

    def inverse_in_column(self, column: int) -> np.ndarray:
        """Blocks in one column of ``A^-1``: (n, 6, 6)."""
        rhs = np.zeros((len(self.position), SIDE, SIDE))
        rhs[column] = np.eye(SIDE)
        return self.solve(rhs)

    def inverse(self) -> np.ndarray:
        """Blocks of ``A^-1`` where L has some: (m, 6, 6)."""
        Z = np.zeros_like(self.L)
        _invert(self.starts, self.rows, self.L.copy(), Z, np.empty((1, SIDE, SIDE)))
        return Z

    @cached_property
    def _inverse(self) -> np.ndarray:
        return self.inverse()

    @cached_property
    def diagonal_of_inverse(self) -> np.ndarray:
        """Blocks along the diagonal of ``A^-1``: (n, 6, 6)."""
        return np.asarray(self._inverse[self.starts[:-1]][self.position])

    def inverse_between(self, rows: Indices, columns: Indices) -> np.ndarray:
        """Blocks of ``A^-1`` between unknowns that are coupled: (k, 6, 6)."""
        at, is_above = _find(self.starts, self.rows, self.position[rows], self.position[columns])
        return _flipped(self._inverse[at], is_above)


def _find(starts: Indices, rows: Indices, one: Indices, other: Indices) -> tuple[Indices, Mask]:
    """Find blocks in L, by their rows and columns in its order; and which lie above its diagonal."""
    n = len(starts) - 1
    keys = np.repeat(np.arange(n), np.diff(starts)) * n + rows
    return np.searchsorted(keys, np.minimum(one, other) * n + np.maximum(one, other)), one < other


def _flipped(blocks: np.ndarray, is_above: Mask) -> np.ndarray:
    """Blocks (k, 6, 6), those above the diagonal transposed."""
    return np.where(is_above[:, None, None], np.swapaxes(blocks, 1, 2), blocks)


def _order(i: Indices, j: Indices, n: int) -> tuple[Indices, Indices, Indices]:
    """Minimum degree order of n blocks of which some are coupled, and the pattern of L.

    It is the pattern for a network of resistors with the same pattern, in which nothing cancels.
    """
    off = i != j
    one, other = np.concatenate([i[off], j[off]]), np.concatenate([j[off], i[off]])
    resistors = csc_array(coo_array((np.full(len(one), -1.0), (one, other)), shape=(n, n)))
    network = resistors + diags_array(GROUNDED - np.asarray(resistors.sum(axis=0)).ravel())
    options = {"SymmetricMode": True}
    lu = splu(csc_array(network), permc_spec="MMD_AT_PLUS_A", diag_pivot_thresh=0.0, options=options)
    pattern = lu.L
    pattern.sort_indices()
    position, starts, rows = (np.asarray(a, np.int64) for a in (lu.perm_c, pattern.indptr, pattern.indices))
    return position, starts, rows


@compiled
def _factor(starts: Indices, rows: Indices, L: np.ndarray, turned: np.ndarray) -> bool:
    """Overwrite the lower blocks of a matrix by those of its factor, column by column; False if a pivot fails."""
    for j in range(len(starts) - 1):
        d, end = starts[j], starts[j + 1]
        if not _factor_pivot(L, d):
            return False
        for q in range(d + 1, end):
            _divide(L, q, d)
        for q in range(d + 1, end):
            _transpose(L, q, turned)
            # The column of that row takes its share: both lists of rows ascend.
            at = starts[rows[q]]
            for r in range(q, end):
                while rows[at] < rows[r]:
                    at += 1
                _subtract(L, at, L, r, turned, ONLY)
    return True


@compiled
def _factor_pivot(L: np.ndarray, d: int) -> bool:
    """Overwrite block d by its own factor; False if it has none."""
    for a in range(SIDE):
        for b in range(a + 1):
            s = L[d, a, b]
            for c in range(b):
                s -= L[d, a, c] * L[d, b, c]
            if a == b and not s > 0:
                return False
            L[d, a, b] = s / L[d, b, b] if a > b else np.sqrt(s)
        for b in range(a + 1, SIDE):
            L[d, a, b] = 0.0
    return True


@compiled
def _divide(L: np.ndarray, q: int, d: int) -> None:
    """Overwrite block q, X, by the solution of ``Y L_d^T = X``."""
    for a in range(SIDE):
        for b in range(SIDE):
            s = L[q, a, b]
            for c in range(b):
                s -= L[q, a, c] * L[d, b, c]
            L[q, a, b] = s / L[d, b, b]


@compiled
def _transpose(A: np.ndarray, q: int, turned: np.ndarray) -> None:
    for a in range(SIDE):
        for b in range(SIDE):
            turned[0, b, a] = A[q, a, b]


@compiled
def _subtract(A: np.ndarray, at: int, X: np.ndarray, r: int, Y: np.ndarray, q: int) -> None:
    """``A[at] -= X[r] Y[q]``."""
    for a in range(SIDE):
        # A row at a time, each number by itself: so the compiler knows that nothing it reads is written meanwhile.
        s0, s1, s2, s3, s4, s5 = A[at, a, 0], A[at, a, 1], A[at, a, 2], A[at, a, 3], A[at, a, 4], A[at, a, 5]
        for c in range(SIDE):
            x = X[r, a, c]
            s0 -= x * Y[q, c, 0]
            s1 -= x * Y[q, c, 1]
            s2 -= x * Y[q, c, 2]
            s3 -= x * Y[q, c, 3]
            s4 -= x * Y[q, c, 4]
            s5 -= x * Y[q, c, 5]
        A[at, a, 0], A[at, a, 1], A[at, a, 2], A[at, a, 3], A[at, a, 4], A[at, a, 5] = s0, s1, s2, s3, s4, s5


@compiled
def _solve(starts: Indices, rows: Indices, L: np.ndarray, y: np.ndarray, turned: np.ndarray) -> None:
    """Overwrite blocks y (n, 6, 6), six right-hand sides, by ``L^-T L^-1 y``."""
    for j in range(len(starts) - 1):
        d = starts[j]
        for a in range(SIDE):
            for c in range(a):
                for k in range(SIDE):
                    y[j, a, k] -= L[d, a, c] * y[j, c, k]
            for k in range(SIDE):
                y[j, a, k] /= L[d, a, a]
        # What block j explains is taken from the blocks below.
        for q in range(d + 1, starts[j + 1]):
            _subtract(y, rows[q], L, q, y, j)
    for j in range(len(starts) - 2, -1, -1):
        d = starts[j]
        for q in range(d + 1, starts[j + 1]):
            _transpose(L, q, turned)
            _subtract(y, j, turned, ONLY, y, rows[q])
        for a in range(SIDE - 1, -1, -1):
            for c in range(a + 1, SIDE):
                for k in range(SIDE):
                    y[j, a, k] -= L[d, c, a] * y[j, c, k]
            for k in range(SIDE):
                y[j, a, k] /= L[d, a, a]


@compiled
def _invert(starts: Indices, rows: Indices, N: np.ndarray, Z: np.ndarray, turned: np.ndarray) -> None:
    """Blocks Z of the inverse where L has some, column by column from the last; N is L, which is used up."""
    for j in range(len(starts) - 2, -1, -1):
        d, end = starts[j], starts[j + 1]
        _invert_pivot(N, d)
        for q in range(d + 1, end):
            _times_pivot(N, q, d)
        for q in range(d + 1, end):
            # The column of each row below holds what is needed.
            at = starts[rows[q]]
            for r in range(q, end):
                while rows[at] < rows[r]:
                    at += 1
                _subtract(Z, r, Z, at, N, q)
                if r > q:
                    _transpose(Z, at, turned)
                    _subtract(Z, q, turned, ONLY, N, r)
        for q in range(d + 1, end):
            _transpose(N, q, turned)
            _subtract(Z, d, turned, ONLY, Z, q)
        _transpose(N, d, turned)
        for a in range(SIDE):
            for c in range(a, SIDE):
                for b in range(c + 1):
                    Z[d, a, b] += turned[0, a, c] * N[d, c, b]


@compiled
def _invert_pivot(N: np.ndarray, d: int) -> None:
    """Overwrite block d, lower triangular, by its inverse."""
    for b in range(SIDE):
        N[d, b, b] = 1.0 / N[d, b, b]
        for a in range(b + 1, SIDE):
            s = 0.0
            for c in range(b, a):
                s -= N[d, a, c] * N[d, c, b]
            N[d, a, b] = s / N[d, a, a]


@compiled
def _times_pivot(N: np.ndarray, q: int, d: int) -> None:
    """Multiply block q by block d, lower triangular, from the right."""
    for a in range(SIDE):
        for b in range(SIDE):
            s = 0.0
            for c in range(b, SIDE):
                s += N[q, a, c] * N[d, c, b]
            N[q, a, b] = s
