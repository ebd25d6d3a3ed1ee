# SPDX-License-Identifier: BSD-3-Clause
"""Fields of Gaussians on a regular grid of nodes, evaluated one axis after the other.

Every derivative of a Gaussian is a product of one function per axis: field and derivatives at points are one matrix
product and two short sums.
"""

import logging
from collections.abc import Callable, Iterator
from dataclasses import dataclass

import numpy as np
from scipy.spatial import cKDTree

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
from magmatch.grid import distinct_cells
from magmatch.typing import Mask, Matrix, Points, Scalars, Vector3

log = logging.getLogger(__name__)

# Grid coordinates beyond this would not be whole numbers in float64 any more.
_LARGEST_INDEX = 2.0**50
# Largest temporary array, in numbers: 64 MiB.
_CHUNK_NUMBERS = 2**23
# Boxes that hold more numbers than this per node in use cost more than summing over the nodes one by one.
_MOST_BOX_PER_NODE = 30


@dataclass(frozen=True, eq=False, slots=True)
class InducingGrid:
    """Some nodes of a regular grid.

    ``index`` (m, 3) holds their grid coordinates, not negative, in C order; node (0, 0, 0) lies at ``origin`` (m).
    """

    origin: Vector3
    spacing: float
    index: np.ndarray

    def __len__(self) -> int:
        return len(self.index)

    @property
    def nodes(self) -> Points:
        """Positions of the nodes in use, m."""
        return np.asarray(self.origin + self.spacing * self.index)

    def levels(self) -> tuple[list[np.ndarray], list[np.ndarray]]:
        """Coordinates (m) in use along each axis, ascending, and which of them each node has.

        Gaps remain where no node lies, so that far-flung surveys do not cost what lies between.
        """
        found = [np.unique(self.index[:, k], return_inverse=True) for k in range(3)]
        coordinates = [self.origin[k] + self.spacing * level for k, (level, _) in enumerate(found)]
        return coordinates, [place for _, place in found]


def lay_inducing_grid(points: Points, spacing: float, reach: float) -> InducingGrid:
    """Nodes of a grid centred over the points' box that are within reach of a point."""
    origin = _centred_origin(points, spacing)
    n_steps = int(np.ceil(reach / spacing))
    candidates = _dilated(_occupied_cells(points, origin, spacing), -n_steps, n_steps + 1)
    # Half a cell's diagonal always counts as near, so that every sample is surrounded by nodes.
    radius = max(reach, spacing * float(np.sqrt(3)) / 2)
    distance, _ = cKDTree(points).query(
        origin + spacing * candidates, distance_upper_bound=radius * (1 + 1e-9), workers=1
    )
    index = candidates[np.isfinite(distance)]
    first = index.min(axis=0)
    return InducingGrid(origin + spacing * first, float(spacing), index - first)


def lay_affordable_grid(
    points: Points, spacing: float, reach_at: Callable[[float], float], max_nodes: int
) -> InducingGrid:
    """Lay a grid with the spacing asked for, or the least wider one that needs no more nodes than allowed."""
    h = spacing
    while True:
        # Every occupied cell needs a node, a node serves eight cells: says "too many" before laying any.
        n_at_least = len(_occupied_cells(points, _centred_origin(points, h), h)) / 8
        n_at_least = max(n_at_least, _ball(reach_at(h) / h))
        if n_at_least <= max_nodes:
            grid = lay_inducing_grid(points, h, reach_at(h))
            n_at_least = len(grid)
        if n_at_least <= max_nodes:
            break
        h *= max(1.02, min(2.0, (n_at_least / max_nodes) ** (1 / 3)))
    if grid.spacing > spacing:
        log.info("inducing points %.3g m apart, not %.3g m: at most %d allowed", grid.spacing, spacing, max_nodes)
    return grid


def _centred_origin(points: Points, spacing: float) -> Vector3:
    """Origin of a grid centred over the points' box, so that both ends are treated alike."""
    low, high = points.min(axis=0), points.max(axis=0)
    if not (spacing > 0 and (high - low).max() / spacing < _LARGEST_INDEX):
        msg = f"cannot lay inducing points {spacing} m apart over {high - low} m: choose another spacing"
        raise ValueError(msg)
    n_cells = np.ceil((high - low) / spacing - 1e-9)
    return np.asarray((low + high - n_cells * spacing) / 2)


def _occupied_cells(points: Points, origin: Vector3, spacing: float) -> np.ndarray:
    """Grid coordinates of the cells that hold samples."""
    return distinct_cells(np.floor((points - origin) / spacing + 1e-9).astype(np.int64))


def _dilated(cells: np.ndarray, first: int, last: int) -> np.ndarray:
    """All grid coordinates within some steps of cells, one axis after the other."""
    steps = np.arange(first, last + 1)
    for axis in range(3):
        offsets = np.zeros((len(steps), 3), dtype=np.int64)
        offsets[:, axis] = steps
        cells = distinct_cells((cells[:, None] + offsets).reshape(-1, 3))
    return cells


def _ball(radius: float) -> float:
    """About how many grid nodes lie in a ball of some spacings."""
    return 4 / 3 * float(np.pi) * max(radius - 1, 0) ** 3


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
