# SPDX-License-Identifier: BSD-3-Clause
"""Inducing points lie at the nodes of a regular grid that are within reach of samples."""

import logging
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from scipy.spatial import cKDTree

from magmatch.grid import distinct_cells
from magmatch.typing import Points, Vector3

log = logging.getLogger(__name__)

# Grid coordinates beyond this would not be whole numbers in float64 any more.
_LARGEST_INDEX = 2.0**50


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
