# SPDX-License-Identifier: BSD-3-Clause
"""A sparse matrix written out."""

import numpy as np

from magmatch.field.cholesky.cells import HALF_STENCIL


def to_dense(matrix, cells):
    """Dense form of a `StencilMatrix`, (m + 3, m + 3)."""
    m = cells.n_nodes
    dense = np.zeros((m + 3, m + 3))
    other = cells.node_index.ravel()[cells.flat_nodes[:, None] + cells.shifts[HALF_STENCIL - 1 :]]
    row, slot = np.nonzero(other >= 0)
    dense[row, other[row, slot]] = dense[other[row, slot], row] = matrix.stencil[row, slot]
    dense[:m, m:], dense[m:, :m], dense[m:, m:] = matrix.border, matrix.border.T, matrix.corner
    return dense
