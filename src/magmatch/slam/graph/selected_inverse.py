# SPDX-License-Identifier: BSD-3-Clause
"""Selected inverse of a sparse matrix, on the pattern of its factor (Takahashi): each node's marginal covariance."""

import numpy as np
from scipy.sparse import csc_array, diags_array
from scipy.sparse.linalg import SuperLU, splu

from magmatch.compiled import compiled
from magmatch.typing import Indices, Scalars

# Of each node of the network to the ground, over that of a tie: small, so that currents reach far.
GROUNDED = 1e-6


def factorised(H: csc_array) -> SuperLU:
    """Factor a symmetric positive definite matrix: pivots stay on the diagonal."""
    symmetric = {"SymmetricMode": True}
    return splu(H, permc_spec="MMD_AT_PLUS_A", diag_pivot_thresh=0.0, options=symmetric)


def inverse_blocks(H: csc_array, lu: SuperLU, n: int, side: int) -> np.ndarray:
    """First n blocks along the diagonal of the inverse of H: (n, side, side).

    H is sparse, symmetric and positive definite, and these blocks are among its entries, zeros too; ``lu`` is of it.
    """
    order = np.argsort(lu.perm_c)
    # The factor leaves out what happens to be zero, where the inverse is not: the pattern is that of the factor of a
    # network of resistors with the same ties, in which nothing cancels.
    ties = csc_array((np.full(H.nnz, -1.0), H.indices, H.indptr), shape=H.shape)
    ties = ties + diags_array(GROUNDED - np.asarray(ties.sum(axis=0)).ravel())
    pattern = splu(csc_array(ties[order][:, order]), permc_spec="NATURAL", diag_pivot_thresh=0.0).L
    size, keys = len(order), _keys(pattern)
    L = np.zeros(len(keys))
    L[np.searchsorted(keys, _keys(lu.L))] = lu.L.data
    Z = _inverse(pattern.indptr, keys % size, L, lu.U.diagonal())
    at = lu.perm_c[: n * side].reshape(n, side)
    i, j = np.broadcast_arrays(at[:, :, None], at[:, None, :])
    return np.asarray(Z[np.searchsorted(keys, np.minimum(i, j) * size + np.maximum(i, j))])


def _keys(L: csc_array) -> Indices:
    """Column and row of each entry in one number, in order; entries are put in order too."""
    L.sort_indices()
    return np.repeat(np.arange(L.shape[1]), np.diff(L.indptr)) * L.shape[0] + L.indices


@compiled
def _inverse(starts: Indices, rows: Indices, L: Scalars, pivots: Scalars) -> Scalars:
    """Entries of the inverse at those of the unit lower factor, column by column from the last."""
    Z = np.zeros(len(L))
    for j in range(len(pivots) - 1, -1, -1):
        first, end = starts[j] + 1, starts[j + 1]
        for q in range(first, end):
            # The column of each row below holds what is needed: both lists of rows ascend.
            at, stop = starts[rows[q]], starts[rows[q] + 1]
            for r in range(q, end):
                while at < stop and rows[at] < rows[r]:
                    at += 1
                if at < stop and rows[at] == rows[r]:
                    Z[q] -= Z[at] * L[r]
                    if r > q:
                        Z[r] -= Z[at] * L[q]
        Z[first - 1] = 1.0 / pivots[j]
        for q in range(first, end):
            Z[first - 1] -= Z[q] * L[q]
    return Z
