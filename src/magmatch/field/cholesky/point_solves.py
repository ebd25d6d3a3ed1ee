# SPDX-License-Identifier: BSD-3-Clause
"""Covariances at chosen points through solves with the factor: no inverse, and only the fronts above each point.

For a row phi of the linear model, ``phi A^-1 phi^T = |L^-1 phi|^2``. All unknowns of a cell lie in the front that
eliminates the first of them, so a point enters there and climbs to the root; points sorted by where they enter are
neighbours at every front they share.
"""

from collections.abc import Iterator

import numpy as np

from magmatch.field.cholesky.multifrontal import CholeskyFactor
from magmatch.field.cholesky.nested_dissection import Elimination


def solve_operations(elimination: Elimination, unknowns: np.ndarray, n_rows: int) -> float:
    """Floating-point operations of `half_solves`."""
    climb = np.zeros(len(elimination.fronts))
    for k in range(len(climb) - 1, -1, -1):
        front = elimination.fronts[k]
        n = front.stop - front.start
        climb[k] += n * n + 2.0 * n * len(front.border)
        for child in front.children:
            climb[child] = climb[k]
    first = elimination.position[unknowns].min(axis=1)
    entry = np.searchsorted([front.stop for front in elimination.fronts], first, side="right")
    return float(n_rows * climb[entry].sum())


def half_solves(
    factor: CholeskyFactor, unknowns: np.ndarray, rows: np.ndarray
) -> Iterator[tuple[np.ndarray, np.ndarray]]:
    """Parts of ``L^-1 phi^T`` for rows phi of the linear model, front by front."""
    e = factor.elimination
    position = e.position[unknowns]
    first = position.min(axis=1)
    order = np.argsort(first, kind="stable")
    first = first[order]
    n_rows = rows.shape[1]
    subtree = np.zeros(len(e.fronts), dtype=np.int64)
    waiting: dict[int, tuple[int, int, np.ndarray]] = {}
    for k, (front, L, X) in enumerate(zip(e.fronts, factor.pivots, factor.below, strict=True)):
        n = front.stop - front.start
        subtree[k] = min([front.start, *(int(subtree[c]) for c in front.children)])
        low, high = (int(i) for i in np.searchsorted(first, [subtree[k], front.stop]))
        if low == high:
            continue
        # In the factor's own precision, or all of the factor would be converted for a few points.
        local = np.zeros((n + len(front.border), high - low, n_rows), factor.precision)
        for child, child_rows in zip(front.children, front.child_rows, strict=True):
            if child in waiting:
                start, stop, update = waiting.pop(child)
                local[child_rows, start - low : stop - low] += update
        for column in range(int(np.searchsorted(first, front.start)), high):
            at = position[order[column]]
            later = n + np.searchsorted(front.border, at)
            local[np.where(at < front.stop, at - front.start, later), column - low] = rows[order[column]].T
        flat = local.reshape(len(local), -1)
        # Transposed views are in BLAS' own order: nothing is copied.
        own = factor.trsm(1.0, L, flat[:n].T, side=1, lower=1, trans_a=1).T if n else flat[:n]
        waiting[k] = (low, high, (flat[n:] - X @ own).reshape(len(front.border), high - low, n_rows))
        yield order[low:high], own.reshape(n, high - low, n_rows)


def marginal_covariances(factor: CholeskyFactor, unknowns: np.ndarray, rows: np.ndarray) -> np.ndarray:
    """Covariance of each point's own rows, ``phi A^-1 phi^T``."""
    out = np.zeros((len(rows), rows.shape[1], rows.shape[1]))
    for points, part in half_solves(factor, unknowns, rows):
        columns = part.transpose(1, 2, 0)
        out[points] += columns @ columns.transpose(0, 2, 1)
    return out


def joint_covariances(factor: CholeskyFactor, unknowns: np.ndarray, rows: np.ndarray) -> np.ndarray:
    """Covariance of all points' rows with each other."""
    n, n_rows, _ = rows.shape
    out = np.zeros((n, n_rows, n, n_rows))
    for points, part in half_solves(factor, unknowns, rows):
        columns = part.reshape(len(part), len(points) * n_rows)  # also where a front eliminates nothing
        block = (columns.T @ columns).reshape(len(points), n_rows, len(points), n_rows)
        out[points[:, None], :, points] += block.transpose(0, 2, 1, 3)
    return out.reshape(n * n_rows, n * n_rows)
