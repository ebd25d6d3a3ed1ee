# SPDX-License-Identifier: BSD-3-Clause
"""The active cells and spline nodes: those within reach of a sample, so that cost depends on the data."""

from dataclasses import dataclass
from math import prod

import numpy as np

from magmatch.compiled import compiled
from magmatch.errors import ConfigurationError
from magmatch.grid import spanned_points
from magmatch.typing import Points

# Memory: about 4 kB per active cell for the matrices, as much again for the factor; 8 bytes per cell of the box.
MAX_ACTIVE_CELLS = 400_000
MAX_BOX_CELLS = 40_000_000
# Two nodes interact when they touch a common cell: offsets -3..3 along each axis, 343 in all. Symmetric matrices
# keep the second half, from the node itself on.
STENCIL_REACH = 3
_STENCIL_SHAPE = (2 * STENCIL_REACH + 1,) * 3
FULL_STENCIL = prod(_STENCIL_SHAPE)
HALF_STENCIL = (FULL_STENCIL + 1) // 2

# Nodes of a cell, from its first one.
LOCAL_NODES = spanned_points([np.arange(4)] * 3)
_FLAT = np.ravel_multi_index(tuple(LOCAL_NODES.T), _STENCIL_SHAPE)
# [a, b], a <= b: place in the half stencil of the offset from the cell's node a to its node b.
HALF_OFFSET = _FLAT[None] - _FLAT[:, None]


@dataclass(frozen=True, eq=False, slots=True)
class CellGrid:
    """Active cells of a regular grid and the spline nodes that touch them."""

    # (3,): where cell (0, 0, 0) lies on the lattice, whose cell i is centred at ``i spacing`` along each axis, so
    # that grids over different samples share their splines
    first: np.ndarray
    spacing: float  # m: side of a cell
    # (c, 3): indices of the active cells; cell (i, j, k) is touched by nodes (i..i+3, j..j+3, k..k+3)
    cells: np.ndarray
    distance: np.ndarray  # (c,): from each active cell's centre to that of the nearest occupied one, in cells
    cell_index: np.ndarray  # (nx, ny, nz): number of each active cell in ``cells``; -1 elsewhere
    # (nx + 9, ny + 9, nz + 9): number of each node, padded by 3 on every side; -1 where no active cell touches it
    node_index: np.ndarray
    nodes: np.ndarray  # (m, 3): indices of the nodes
    cell_nodes: np.ndarray  # (c, 64): nodes of each active cell
    flat_nodes: np.ndarray  # (m,): row of each node in the flattened ``node_index``
    shifts: np.ndarray  # (343,): from there to the rows of its neighbours

    @property
    def n_cells(self) -> int:
        """Number of active cells."""
        return len(self.cells)

    @property
    def n_nodes(self) -> int:
        """Number of splines."""
        return len(self.nodes)

    def locate(self, points: Points) -> tuple[np.ndarray, Points]:
        """Active cell of each point (-1 where there is none) and the position in it, 0 to 1 along each axis."""
        cell, t = np.zeros(len(points), dtype=np.int64), np.zeros((len(points), 3))
        u = lattice_coordinate(np.asarray(points, dtype=np.float64), self.spacing) - self.first
        _locate(u, self.cell_index, cell, t, np.zeros(3, dtype=np.int64))
        return cell, t


@compiled
def _locate(u, cell_index, cell, t, ijk):  # type: ignore[no-untyped-def]
    """Active cell of each point, given in cells from the first, and the position in it; -1 where there is none."""
    for n in range(len(u)):
        is_inside = True  # which NaN is nowhere
        for axis in range(3):
            t[n, axis] = u[n, axis] - np.floor(u[n, axis])
            is_inside = is_inside and 0 <= u[n, axis] < cell_index.shape[axis]
            if is_inside:
                ijk[axis] = int(np.floor(u[n, axis]))
        cell[n] = cell_index[ijk[0], ijk[1], ijk[2]] if is_inside else -1


def count_active_cells(points: Points, spacing: float, reach: float, most_in_box: float = MAX_BOX_CELLS) -> float:
    """How many cells `lay_cells` would activate; infinite where their box holds more than are worth looking at."""
    _, occupied, shape = _occupied(points, spacing, reach)
    if np.prod(shape) > most_in_box:
        return np.inf
    return float(np.isfinite(_distances(occupied, shape, reach)).sum())


def lattice_coordinate(x: np.ndarray, spacing: float) -> np.ndarray:
    """Coordinate in cells; its integer part is the cell. A flat survey through the origin fills one layer."""
    return np.asarray(x / spacing + 0.5)


def lay_cells(
    points: Points, spacing: float, reach: float, box: tuple[np.ndarray, np.ndarray] | None = None
) -> CellGrid:
    """Lay cells over all places within reach of a sample."""
    first, occupied, shape = _occupied(points, spacing, reach)
    n_box = float(np.prod(shape))
    if n_box > MAX_BOX_CELLS:
        _refuse(f"{n_box:.3g} cells in the box of the samples, at most {MAX_BOX_CELLS:,}", spacing)
    distance = _distances(occupied, shape, reach)
    if box is not None:
        low, high = np.maximum(box[0] - first, 0), np.maximum(box[1] - first, 0)
        distance = distance[low[0] : high[0], low[1] : high[1], low[2] : high[2]]
        first = first + low
    is_active = np.isfinite(distance)
    cells = np.argwhere(is_active)
    if len(cells) > MAX_ACTIVE_CELLS:
        _refuse(f"{len(cells):,} cells near samples, at most {MAX_ACTIVE_CELLS:,}", spacing)
    cell_index = np.full(distance.shape, -1, dtype=np.int32)
    cell_index[is_active] = np.arange(len(cells), dtype=np.int32)
    node_index = np.full(tuple(np.add(distance.shape, 3 + 2 * STENCIL_REACH)), -1, dtype=np.int32)
    is_node = np.pad(is_active, (STENCIL_REACH, 2 * STENCIL_REACH))
    for axis in range(3):
        # Nodes i to i + 3 touch cell i: what is one on, then what is two.
        for step in (1, 2):
            there, here = (slice(None),) * axis + (slice(step, None),), (slice(None),) * axis + (slice(None, -step),)
            is_node[there] |= is_node[here].copy()
    nodes = np.argwhere(is_node)
    node_index[is_node] = np.arange(len(nodes), dtype=np.int32)
    _, n_y, n_z = node_index.shape
    around = spanned_points([np.arange(-STENCIL_REACH, STENCIL_REACH + 1)] * 3)
    corner, offset, shifts = (p @ np.array([n_y * n_z, n_z, 1]) for p in (cells + STENCIL_REACH, LOCAL_NODES, around))
    return CellGrid(
        first=first,
        spacing=float(spacing),
        cells=cells,
        distance=distance[is_active].astype(np.float64),
        cell_index=cell_index,
        node_index=node_index,
        nodes=nodes - STENCIL_REACH,
        cell_nodes=node_index.ravel()[corner[:, None] + offset],
        flat_nodes=np.flatnonzero(is_node),
        shifts=shifts,
    )


def _refuse(needed: str, spacing: float) -> None:
    msg = f"the region is too large for a spacing of {spacing:.3g} m: {needed}; widen the spacing or map it in parts"
    raise ConfigurationError(msg)


def _occupied(points: Points, spacing: float, reach: float) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """First cell, distinct occupied cells (none where the box is too large) and number of cells along each axis."""
    if len(points) == 0:
        msg = "expected at least one sample to lay cells around, got none"
        raise ValueError(msg)
    if not (spacing > 0 and reach >= 0):
        msg = f"expected a positive spacing and a reach of at least 0, got {spacing} m and {reach} cells"
        raise ValueError(msg)
    cell = np.floor(lattice_coordinate(points, spacing))
    pad = np.floor(reach)
    first, last = cell.min(axis=0) - pad, cell.max(axis=0) + pad
    shape = last - first + 1
    if np.prod(shape) > MAX_BOX_CELLS:
        return first.astype(np.int64), np.zeros((0, 3), dtype=np.int64), shape
    sizes = tuple(shape.astype(np.int64))
    flat = np.unique(np.ravel_multi_index(tuple((cell - first).astype(np.int64).T), sizes))
    return first.astype(np.int64), np.stack(np.unravel_index(flat, sizes), axis=1).astype(np.int64), shape


def _distances(occupied: np.ndarray, shape: np.ndarray, reach: float) -> np.ndarray:
    """Distance of every cell of the box to the nearest occupied one, infinite beyond the reach (all in cells)."""
    distance = np.full(tuple(shape.astype(np.int64)), np.inf, dtype=np.float32)
    offsets = ball_offsets(reach)
    _spread(occupied, offsets, np.sqrt((offsets**2).sum(axis=1)).astype(np.float32), distance)
    return distance


@compiled
def _spread(occupied: np.ndarray, offsets: np.ndarray, length: np.ndarray, distance: np.ndarray) -> None:
    for i in range(occupied.shape[0]):
        for k in range(offsets.shape[0]):
            x, y, z = occupied[i, 0] + offsets[k, 0], occupied[i, 1] + offsets[k, 1], occupied[i, 2] + offsets[k, 2]
            distance[x, y, z] = min(distance[x, y, z], length[k])


def ball_offsets(radius: float) -> np.ndarray:
    """Offsets (n, 3) of the cells whose centres lie within a radius (in cells)."""
    r = int(np.floor(radius))
    axis = np.arange(-r, r + 1)
    offsets = spanned_points([axis] * 3)
    return np.asarray(offsets[(offsets**2).sum(axis=1) <= radius**2 + 1e-9])
