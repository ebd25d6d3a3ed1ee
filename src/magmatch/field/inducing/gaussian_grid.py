# SPDX-License-Identifier: BSD-3-Clause
"""Fields of Gaussians on a regular grid of nodes, evaluated one axis after the other.

Every derivative of a Gaussian is a product of one function per axis: field and derivatives at points are one matrix
product and two short sums.
"""

from collections.abc import Callable, Iterator
from dataclasses import dataclass

import numpy as np

from magmatch.field.inducing.inducing_grid import InducingGrid
from magmatch.field.inducing.kernels import (
    N_ROWS,
    Alpha,
    Term,
    derivative_plan,
    hermite_functions,
    highest_derivative,
    stack_products,
    weights_per_node,
)
from magmatch.field.values import FieldValues
from magmatch.typing import Mask, Matrix, Points, Scalars, Vector3

# Largest temporary array, in numbers: 64 MiB.
_CHUNK_NUMBERS = 2**23
# Boxes that hold more numbers than this per node in use cost more than summing over the nodes one by one.
_MOST_BOX_PER_NODE = 30


@dataclass(frozen=True, eq=False, slots=True)
class GaussianGrid:
    """A vector basis made of Gaussians on grid nodes by a differential operator; unit prior variance.

    Weights are component-major: ``weights[b m + j]`` is component b of node j; a potential has one component.
    """

    grid: InducingGrid
    lengthscale: float
    terms: tuple[Term, ...]

    @property
    def n_weights(self) -> int:
        """One or three per node."""
        return self.n_components * len(self.grid)

    @property
    def n_components(self) -> int:
        """How many weights a node has."""
        return weights_per_node(self.terms)

    def is_whole(self, points: Points) -> Mask:
        """Nowhere: between and beyond the nodes the kernel says more than they can represent."""
        return np.zeros(len(points), dtype=np.bool_)

    def gram(self) -> Matrix:
        """Prior covariance of what the weights stand for: the field at the nodes, or the potential over l."""
        if self.n_components == 3:
            return self.design(self.grid.nodes)
        return self._products(self.grid.nodes, 0)((0, 0, 0))

    def design(self, points: Points, order: int = 0) -> Matrix:
        """Field and derivatives at points per unit of each weight."""
        product_of, shape = self._products(points, order), (len(points), len(self.grid))
        stacked = stack_products(product_of, self.terms, order, self.lengthscale, shape)
        return stacked.reshape(N_ROWS[order] * len(points), self.n_weights)

    def evaluate(self, points: Points, weights: np.ndarray, order: int, constant: Vector3) -> FieldValues:
        """Field and derivatives at scattered points."""
        out = np.zeros((N_ROWS[order], len(points)))
        if self._is_box_too_empty():
            for rows in chunks(len(points), N_ROWS[order] * self.n_weights):
                part = self.design(points[rows], order) @ weights
                out[:, rows] = part.reshape(N_ROWS[order], -1)
        else:
            box = self._scattered(weights)
            n_lines = self.n_components * (highest_derivative(self.terms, order) + 1) * box.shape[2] * box.shape[3]
            for rows in chunks(len(points), n_lines):
                self._sum_at_points(points[rows], box, order, out[:, rows])
        return rows_as_values(out, order, constant)

    def _products(self, points: Points, order: int) -> Callable[[Alpha], Matrix]:
        """Gives the derivatives of the Gaussians of all nodes at points: (n, m)."""
        x, y, z = self._tables((points[:, 0], points[:, 1], points[:, 2]), order)
        i, j, k = self.grid.levels()[1]
        return lambda alpha: np.asarray(x[alpha[0]][:, i] * y[alpha[1]][:, j] * z[alpha[2]][:, k])

    def _tables(self, coordinates: tuple[Scalars, ...], order: int) -> list[np.ndarray]:
        """Hermite functions of coordinates against the nodes' coordinates, per axis: (highest + 1, q, n_axis)."""
        highest = highest_derivative(self.terms, order)
        return [
            hermite_functions((x[:, None] - nodes) / self.lengthscale, highest)
            for x, nodes in zip(coordinates, self.grid.levels()[0], strict=True)
        ]

    def _is_box_too_empty(self) -> bool:
        """Whether summing over the nodes one by one is cheaper than over the box around them."""
        return bool(np.prod([float(len(x)) for x in self.grid.levels()[0]]) > _MOST_BOX_PER_NODE * len(self.grid))

    def _scattered(self, weights: np.ndarray) -> np.ndarray:
        """Weights in the full box of the coordinates in use, 0 where no node is: (components, nx, ny, nz)."""
        coordinates, (i, j, k) = self.grid.levels()
        box = np.zeros((self.n_components, *(len(x) for x in coordinates)))
        box[:, i, j, k] = weights.reshape(self.n_components, -1)
        return box

    def _sum_at_points(self, points: Points, box: np.ndarray, order: int, out: np.ndarray) -> None:
        """Add the field of a full box of nodes at some points to ``out`` (rows, n)."""
        x, y, z = self._tables((points[:, 0], points[:, 1], points[:, 2]), order)
        n, nx, ny, nz = box.shape
        plan = derivative_plan(self.terms, order)
        flat = np.ascontiguousarray(box.transpose(0, 2, 3, 1)).reshape(-1, nx)
        along_x = {a: (flat @ x[a].T).reshape(n, ny, nz, -1) for a in {alpha[0] for alpha, _ in plan}}
        yT, zT = (np.ascontiguousarray(t.transpose(0, 2, 1)) for t in (y, z))
        along_xy = {a: np.einsum("bjkn,jn->bkn", along_x[a[0]], yT[a[1]]) for a in {alpha[:2] for alpha, _ in plan}}
        for alpha, targets in plan:
            summed = np.einsum("bkn,kn->bn", along_xy[alpha[:2]], zT[alpha[2]])
            for target in targets:
                out[target.row] += (target.factor / self.lengthscale**target.n_derivatives) * summed[target.weight]


def chunks(n: int, numbers_per_point: int) -> Iterator[slice]:
    """Ranges of n points whose temporary arrays stay bounded."""
    step = max(1, _CHUNK_NUMBERS // max(1, numbers_per_point))
    return (slice(start, min(start + step, n)) for start in range(0, n, step))


def rows_as_values(rows: Matrix, order: int, constant: Vector3 | float = 0.0) -> FieldValues:
    """Field values from rows of components."""
    n = rows.shape[1]
    return FieldValues(
        rows[:3].T + constant,
        np.ascontiguousarray(rows[3:12].T).reshape(n, 3, 3) if order >= 1 else None,
        np.ascontiguousarray(rows[12:].T).reshape(n, 3, 3, 3) if order >= 2 else None,
    )
