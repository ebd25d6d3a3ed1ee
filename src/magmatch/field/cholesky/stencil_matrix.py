# SPDX-License-Identifier: BSD-3-Clause
"""Symmetric matrices over spline nodes and the constant field: one half stencil per node and a border.

Gram matrices, prior precisions and the needed part of covariances all have this pattern, so they add entry by entry.
"""

from dataclasses import dataclass

import numpy as np

from magmatch.compiled import compiled
from magmatch.field.cholesky.cells import HALF_OFFSET, HALF_STENCIL, CellGrid


@dataclass(frozen=True, eq=False, slots=True)
class StencilMatrix:
    """Symmetric matrix of size m + 3: m spline weights, then the three components of the constant field."""

    stencil: np.ndarray  # (m, 172): entry of each node with itself and the nodes after it that share a cell
    border: np.ndarray  # (m, 3): entries of the nodes with the constant
    corner: np.ndarray  # (3, 3): entries of the constant

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

    def times(self, x: np.ndarray, cells: CellGrid) -> np.ndarray:
        """Product with a vector, (m + 3,)."""
        out = np.zeros(len(x))
        _multiply(
            cells.flat_nodes, cells.shifts[HALF_STENCIL - 1 :], cells.node_index.ravel(), self.stencil, self.border,
            self.corner, np.ascontiguousarray(x), out,
        )  # fmt: skip
        return out


def sum_of_elements(cells: CellGrid, element: np.ndarray, weights: np.ndarray) -> np.ndarray:
    """Stencils (m, 172) of the weighted sum of one 64 x 64 matrix over all active cells."""
    stencil = np.zeros((cells.n_nodes, HALF_STENCIL))
    _add_element(stencil, element, weights, cells.cell_nodes, HALF_OFFSET)
    return stencil


@compiled
def _add_element(stencil, element, weights, cell_nodes, half_offset):  # type: ignore[no-untyped-def]
    for n in range(cell_nodes.shape[0]):
        w = weights[n]
        for a in range(64):
            p = cell_nodes[n, a]
            for b in range(a, 64):
                stencil[p, half_offset[a, b]] += w * element[a, b]


@compiled
def _multiply(flat, shifts, lookup, stencil, border, corner, x, out):  # type: ignore[no-untyped-def]
    m = stencil.shape[0]
    for c in range(3):
        for d in range(3):
            out[m + c] += corner[c, d] * x[m + d]
    for i in range(m):
        total = stencil[i, 0] * x[i]
        for o in range(1, stencil.shape[1]):
            q = lookup[flat[i] + shifts[o]]
            if q >= 0:
                total += stencil[i, o] * x[q]
                out[q] += stencil[i, o] * x[i]
        for c in range(3):
            total += border[i, c] * x[m + c]
            out[m + c] += border[i, c] * x[i]
        out[i] += total
