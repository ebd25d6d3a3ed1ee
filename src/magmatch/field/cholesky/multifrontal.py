# SPDX-License-Identifier: BSD-3-Clause
"""Sparse Cholesky factor by dense fronts: factorisation, log-determinant, solves, half solves."""

from collections.abc import Callable
from dataclasses import dataclass
from functools import partial

import numpy as np
import numpy.typing as npt
from scipy.linalg import blas

from magmatch.compiled import compiled
from magmatch.field.cholesky.blas import (
    LOWER,
    NOT_UNIT,
    PLAIN,
    RIGHT,
    STRIP,
    TRANSPOSED,
    address_of,
    gemm,
    potrf,
    syrk,
    trsm,
)
from magmatch.field.cholesky.cells import HALF_STENCIL
from magmatch.field.cholesky.nested_dissection import Elimination
from magmatch.field.cholesky.stencil_matrix import StencilMatrix
from magmatch.threads import side_by_side, single_threaded
from magmatch.typing import Scalars

_NO_SINGLES, _NO_DOUBLES = np.zeros(0, np.float32), np.zeros(0)


@dataclass(frozen=True, eq=False, slots=True)
class CholeskyFactor:
    """``A = L L^T`` in the order of an elimination."""

    elimination: Elimination
    pivots: list[np.ndarray]  # each (n, n): lower triangle of each front's own unknowns
    below: list[np.ndarray]  # each (k, n): rows of L of each front's border

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
                z[front.start : front.stop] = self.trsm(1.0, L, z[front.start : front.stop], lower=1)
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
                z[front.start : front.stop] = self.trsm(1.0, L, own, lower=1, trans_a=1)

    @property
    def precision(self) -> np.dtype[np.floating]:
        """The type of its entries."""
        return self.pivots[0].dtype

    @property
    def trsm(self) -> Callable[..., np.ndarray]:
        """Solver of its triangles."""
        return blas.dtrsm if self.precision == np.float64 else blas.strsm


# Gives the factor in a precision, or a better one where that does not do.
Make = Callable[[type[np.floating]], CholeskyFactor]


class Factors:
    """Factors of one matrix, each made when it is first asked for."""

    def __init__(self, make: Make, made: CholeskyFactor | None = None) -> None:
        self._make = make
        self._made: dict[type[np.floating], CholeskyFactor] = {}
        if made is not None:
            self._keep(np.float32, made)

    @classmethod
    def of(cls, factor: CholeskyFactor) -> "Factors":
        """One factor for everything."""
        return cls(partial(_same, factor), factor)

    @classmethod
    def gone(cls) -> "Factors":
        """None: who asks for one is told."""
        return cls(_refuse)

    @property
    def full(self) -> CholeskyFactor:
        """In double precision."""
        return self._find(np.float64)

    @property
    def light(self) -> CholeskyFactor:
        """In single precision, or in double where that does not do: spreads are right to a thousandth."""
        return self._find(np.float32)

    @property
    def n_bytes(self) -> int:
        """Memory of those that were made."""
        # A list, since another thread may make one meanwhile.
        return sum(factor.n_bytes for factor in {id(f): f for f in list(self._made.values())}.values())

    def _find(self, precision: type[np.floating]) -> CholeskyFactor:
        if precision not in self._made:
            self._keep(precision, self._make(precision))
        return self._made[precision]

    def _keep(self, precision: type[np.floating], factor: CholeskyFactor) -> None:
        self._made[precision] = factor
        if factor.precision == np.float64:
            self._made[np.float64] = factor


def _same(factor: CholeskyFactor, _: type[np.floating]) -> CholeskyFactor:
    return factor


def _refuse(_: type[np.floating]) -> CholeskyFactor:
    msg = "the factors of this posterior are not kept: only its mean can be evaluated"
    raise RuntimeError(msg)


# What the next correction may still change, relative to the largest entry (a solution in double is right to 1e-12);
# how many may be needed, and by how much each has to be smaller than the last.
TOLERANCE, MOST_CORRECTIONS, SLOWEST = 1e-11, 8, 0.2


def refined_solve(A: StencilMatrix, factor: CholeskyFactor, rhs: Scalars) -> Scalars | None:
    """Solve ``A x = rhs`` by iterative refinement (Wilkinson 1963)."""
    x, cells = factor.solve(rhs), factor.elimination.cells
    size = last = float(np.abs(x).max())
    for _ in range(MOST_CORRECTIONS):
        correction = factor.solve(rhs - A.times(x, cells))
        x = x + correction
        change = float(np.abs(correction).max())
        if not change < SLOWEST * last:
            return None
        # Corrections shrink by about the same factor each time, which tells the next one without computing it.
        if change * change / last <= TOLERANCE * size:
            return np.asarray(x)
        last = change
    return None


@single_threaded
def factorise(
    elimination: Elimination, matrix: StencilMatrix, precision: npt.DTypeLike = np.float64
) -> CholeskyFactor:
    """Factorise a positive definite matrix; `numpy.linalg.LinAlgError` names the pivot of one that is not."""
    pivots, below, blocks = _blocks(elimination, precision)
    root = len(elimination.fronts) - 1
    updates = [_NO_SINGLES] * len(elimination.fronts)

    def eliminate(fronts: range) -> None:
        row_at = np.full(elimination.cells.node_index.size, -1, dtype=np.int32)
        for k in fronts:
            updates[k] = _eliminate(elimination, k, matrix, row_at, updates, blocks[k])

    side_by_side(eliminate, elimination.branches)
    eliminate(range(root, root + 1))
    return CholeskyFactor(elimination, pivots, below)


def _blocks(
    elimination: Elimination, precision: npt.DTypeLike
) -> tuple[list[np.ndarray], list[np.ndarray], list[np.ndarray]]:
    """Lay out a factor's pivots and what is below them, and both of a front as one: one piece of memory."""
    sizes = [(front.stop - front.start, len(front.border)) for front in elimination.fronts]
    memory = np.empty(sum(n * (n + k) for n, k in sizes), precision)
    pivots, below, blocks, start = [], [], [], 0
    for n, k in sizes:
        block = memory[start : start + n * (n + k)]
        pivots.append(block[: n * n].reshape((n, n), order="F"))
        below.append(block[n * n :].reshape((k, n), order="F"))
        blocks.append(block)
        start += len(block)
    return pivots, below, blocks


def _eliminate(
    e: Elimination, k: int, matrix: StencilMatrix, row_at: np.ndarray, updates: list[np.ndarray], block: np.ndarray
) -> np.ndarray:
    """Write a front's columns of the factor; gives what is left for its parent, uses up what its children left."""
    front, n = e.fronts[k], e.fronts[k].stop - e.fronts[k].start
    n_below, is_leaf = len(front.border), True
    block[:] = 0
    _assemble(
        front.unknowns, n, e.cells.flat_nodes, e.cells.shifts, row_at, matrix.stencil, matrix.border, matrix.corner,
        *in_precision(block),
    )  # fmt: skip
    update = np.empty(n_below**2, block.dtype)
    for child, rows in zip(front.children, front.child_rows, strict=True):
        _extend_add(
            *in_precision(updates[child]), rows, n, n_below, *in_precision(block), *in_precision(update), is_leaf,
            np.empty(len(rows) + 1, dtype=np.int64),
        )  # fmt: skip
        updates[child], is_leaf = _NO_SINGLES, False  # its memory is needed no more
    if n:
        info = np.zeros(1, np.int32)
        _factor_front(n, n_below, *in_precision(block), *in_precision(update), not is_leaf, info)
        if info[0]:
            msg = f"matrix is not positive definite: pivot {front.start + info[0]} of {e.n_unknowns} fails"
            raise np.linalg.LinAlgError(msg)
    elif is_leaf:
        update[:] = 0
    return update


def flat(A: np.ndarray) -> np.ndarray:
    """A matrix stored column by column as one vector: compiled loops see one layout, however narrow it is."""
    return A.reshape(-1, order="F")


def in_precision(vector: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """A vector as single and as double numbers, of which one is empty: compiled loops see the same types."""
    return (vector, _NO_DOUBLES) if vector.dtype == np.float32 else (_NO_SINGLES, vector)


@compiled
def _assemble(  # type: ignore[no-untyped-def]
    unknowns, n, flat, shifts, row_at, stencil, border, corner, singles, doubles
):  # fmt: skip
    """Copy the matrix' own entries of a front's columns into its block of zeros."""
    m, n_below, n_nodes, is_single = len(stencil), len(unknowns) - n, len(unknowns) - 3, len(singles) > 0
    for row in range(n_nodes):
        row_at[flat[unknowns[row]]] = row
    for j in range(n if n < n_nodes else n_nodes):
        node = unknowns[j]
        for o in range(1 - HALF_STENCIL, HALF_STENCIL):
            row = row_at[flat[node] + shifts[HALF_STENCIL - 1 + o]]
            # Of two nodes, the first holds their entry; what was eliminated before has no row.
            if row < 0 or (o < 0 and row < n):
                continue
            value = stencil[node, o] if o >= 0 else stencil[unknowns[row], -o]
            at = j * n + row if row < n else n * n + j * n_below + row - n
            if row < j:
                at = row * n + j
            if is_single:
                singles[at] = value
            else:
                doubles[at] = value
    # The constant comes last in every front.
    for j in range(n):
        i = unknowns[j]
        for c in range(i - m if i > m else 0, 3):
            value = border[i, c] if i < m else corner[c, i - m]
            row = n_nodes + c
            at = j * n + row if row < n else n * n + j * n_below + row - n
            if is_single:
                singles[at] = value
            else:
                doubles[at] = value
    for row in range(n_nodes):
        row_at[flat[unknowns[row]]] = -1


@compiled
def _extend_add(  # type: ignore[no-untyped-def]  # noqa: PLR0912
    child_singles, child_doubles, rows, n, n_below, singles, doubles, update_singles, update_doubles, is_first, runs
):  # fmt: skip
    """Add the lower triangle of a child's update, this one's being 0 before the first; rows ascend."""
    is_single, size, n_own = len(child_singles) > 0, len(rows), 0
    while n_own < size and rows[n_own] < n:
        n_own += 1
    if is_first:
        for j in range(n_below):
            for at in range(j * n_below + j, (j + 1) * n_below):
                if is_single:
                    update_singles[at] = 0.0
                else:
                    update_doubles[at] = 0.0
    # Neighbours mostly stay neighbours: runs of rows are added as vectors; the border's first row begins another.
    n_runs = 0
    for i in range(size):
        if i == 0 or i == n_own or rows[i] != rows[i - 1] + 1:  # noqa: PLR1714  (a tuple would cost a compilation)
            runs[n_runs] = i
            n_runs += 1
    runs[n_runs] = size
    for j in range(size):
        q = rows[j]
        for r in range(n_runs):
            first, last = runs[r] if runs[r] > j else j, runs[r + 1]
            if first >= last:
                continue
            row, start = rows[first], j * size + first
            to = q * n + row if row < n else row - n + (n * n + q * n_below if q < n else (q - n) * n_below)
            # Unsigned, or every access would first ask whether to count from the end.
            a, b, count = np.uint64(to), np.uint64(start), np.uint64(last - first)
            if is_single and q < n:
                for i in range(count):
                    singles[a + i] += child_singles[b + i]
            elif is_single:
                for i in range(count):
                    update_singles[a + i] += child_singles[b + i]
            elif q < n:
                for i in range(count):
                    doubles[a + i] += child_doubles[b + i]
            else:
                for i in range(count):
                    update_doubles[a + i] += child_doubles[b + i]


@compiled
def _factor_front(n_own, n_below, singles, doubles, update_singles, update_doubles, keep, info):  # type: ignore[no-untyped-def]
    """Factor a front in place and subtract its square from the update, or from 0; info: the pivot that fails."""
    is_single = len(singles) > 0
    size = 4 if is_single else 8
    A = address_of(singles) if is_single else address_of(doubles)
    S = address_of(update_singles) if is_single else address_of(update_doubles)
    X, n, m = A + size * n_own * n_own, np.int32(n_own), np.int32(n_below)
    potrf(is_single, LOWER, n, A, n, info)
    if info[0] != 0 or n_below == 0:
        return
    # X L^-T, strip by strip.
    for j in range(0, n_own, STRIP):
        width, before = np.int32(STRIP if n_own - j > STRIP else n_own - j), np.int32(j)
        block, row = X + size * j * n_below, A + size * j
        if j > 0:
            gemm(is_single, PLAIN, TRANSPOSED, m, width, before, -1.0, X, m, row, n, 1.0, block, m)
        trsm(
            is_single, RIGHT, LOWER, TRANSPOSED, NOT_UNIT, m, width, 1.0, row + size * j * n_own, n, block, m
        )  # fmt: skip
    syrk(is_single, LOWER, PLAIN, m, n, -1.0, X, m, 1.0 if keep else 0.0, S, m)
