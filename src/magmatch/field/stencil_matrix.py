# SPDX-License-Identifier: BSD-3-Clause
"""Symmetric matrices over spline nodes and the constant field: one half stencil per node and a border.

Gram matrices, prior precisions and the needed part of covariances all have this pattern, so they add entry by entry.
"""

from dataclasses import dataclass

import numpy as np
from numba import njit

from magmatch.field.cells import HALF_OFFSET, HALF_STENCIL, CellGrid


@dataclass(frozen=True, eq=False, slots=True)
class StencilMatrix:
    """Symmetric matrix of size m + 3: m spline weights, then the three components of the constant field.

    Attributes
    ----------
    stencil : (m, 172) array
        Entry of each node with itself and the nodes after it that share a cell.
    border : (m, 3) array
        Entries of the nodes with the constant.
    corner : (3, 3) array
        Entries of the constant.
    """

    stencil: np.ndarray
    border: np.ndarray
    corner: np.ndarray

    @classmethod
    def zeros(cls, n_nodes: int) -> "StencilMatrix":
        """Matrix of zeros over a number of nodes."""
        return cls(np.zeros((n_nodes, HALF_STENCIL)), np.zeros((n_nodes, 3)), np.zeros((3, 3)))

    def __add__(self, other: "StencilMatrix") -> "StencilMatrix":
        """Entry by entry."""
        return StencilMatrix(self.stencil + other.stencil, self.border + other.border, self.corner + other.corner)

    def __sub__(self, other: "StencilMatrix") -> "StencilMatrix":
        """Entry by entry."""
        return StencilMatrix(self.stencil - other.stencil, self.border - other.border, self.corner - other.corner)

    def to_dense(self, cells: CellGrid) -> np.ndarray:
        """Dense matrix (m + 3, m + 3), for checks."""
        m = cells.n_nodes
        dense = np.zeros((m + 3, m + 3))
        flat, shifts, lookup = (
            cells.flat_nodes(),
            cells.stencil_shifts()[HALF_STENCIL - 1 :],
            cells.node_index.ravel(),
        )
        other = lookup[flat[:, None] + shifts]
        row, slot = np.nonzero(other >= 0)
        dense[row, other[row, slot]] = self.stencil[row, slot]
        dense[other[row, slot], row] = self.stencil[row, slot]
        dense[:m, m:], dense[m:, :m], dense[m:, m:] = self.border, self.border.T, self.corner
        return dense


def sum_of_elements(cells: CellGrid, element: np.ndarray, weights: np.ndarray) -> np.ndarray:
    """Stencils (m, 172) of the weighted sum of one 64 x 64 matrix over all active cells.

    Parameters
    ----------
    cells : CellGrid
    element : (64, 64) array
        Symmetric.
    weights : (c,) array
        Factor of each cell.

    Returns
    -------
    (m, 172) array
    """
    stencil = np.zeros((cells.n_nodes, HALF_STENCIL))
    _add_element(stencil, element, weights, cells.cell_nodes, HALF_OFFSET)
    return stencil


@njit(cache=True)
def _add_element(
    stencil: np.ndarray, element: np.ndarray, weights: np.ndarray, cell_nodes: np.ndarray, half_offset: np.ndarray
) -> None:
    for n in range(cell_nodes.shape[0]):
        for a in range(64):
            p = cell_nodes[n, a]
            for b in range(a, 64):
                stencil[p, half_offset[a, b]] += weights[n] * element[a, b]
