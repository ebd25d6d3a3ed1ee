# SPDX-License-Identifier: BSD-3-Clause
"""Where a map is asked for keypoints: points of a regular grid that turns with the survey (X* of the paper)."""

from dataclasses import dataclass

import numpy as np

from magmatch.features.config import FeatureConfig
from magmatch.field.cholesky.cells import ball_offsets
from magmatch.field.map import FieldMap
from magmatch.field.values import FieldValues
from magmatch.geometry import transform_points
from magmatch.grid import RegularGrid
from magmatch.progress import tell
from magmatch.typing import Indices, Points, Scalars

# Where less of the samples' box than this lies near a sample, the survey is a path, not a region.
REGION_SHARE = 0.5
# Cells spread around the path at once: bounds memory on long surveys.
_CELLS_AT_ONCE = 2_000_000


@dataclass(frozen=True, eq=False, slots=True)
class InferencePoints:
    """Points of a regular grid that a map knows."""

    grid: RegularGrid  # over the samples' box
    cells: Indices  # (n,): flat indices (C order) of the grid points in use, increasing
    positions: Points  # (n, 3), m, map frame

    def __len__(self) -> int:
        return len(self.cells)

    def support(self, rows: Indices, radius: float) -> tuple[np.ndarray, Scalars]:
        """Points around some rows: (k, s) rows at s offsets (-1: unknown), and their lengths in spacings."""
        offsets = ball_offsets(radius)
        offsets = offsets[np.any(offsets != 0, axis=1)]
        ijk = np.stack(np.unravel_index(self.cells[rows], self.grid.shape), axis=1)
        neighbours = np.full((len(rows), len(offsets)), -1, dtype=np.int64)
        shape = np.asarray(self.grid.shape)
        for column, offset in enumerate(offsets):
            moved = ijk + offset
            inside = np.flatnonzero(np.all((moved >= 0) & (moved < shape), axis=1))
            wanted = np.ravel_multi_index(tuple(moved[inside].T), self.grid.shape)
            found = np.minimum(np.searchsorted(self.cells, wanted), len(self.cells) - 1)
            is_there = self.cells[found] == wanted
            neighbours[inside[is_there], column] = found[is_there]
        return neighbours, np.linalg.norm(offsets, axis=1)


def grid_spacing(field_map: FieldMap, config: FeatureConfig) -> float:
    """Distance of the points of X*: configured, or from the lengthscale and the bound on their number, m."""
    spacing = config.spacing or config.spacing_in_lengthscales * field_map.hyperparameters.lengthscale
    while (n_points := _n_points(*_cells_in_use(field_map, spacing, config))) > config.max_points:
        spacing *= float(max((n_points / config.max_points) ** (1 / 3), 1.02))
    return spacing


def inference_grid(field_map: FieldMap, config: FeatureConfig) -> InferencePoints:
    """Lay X* over the measured region, or along the path, and keep the points that the map knows."""
    spacing = grid_spacing(field_map, config)
    grid, near_path = _cells_in_use(field_map, spacing, config)
    cells = np.arange(grid.n_points, dtype=np.int64) if near_path is None else near_path
    positions = _cell_positions(grid, cells)
    is_known = field_map.knows(positions)
    tell(f"asking the map at {int(is_known.sum())} points, {spacing:.3g} m apart")
    return InferencePoints(grid, cells[is_known], positions[is_known])


def evaluate_at(field_map: FieldMap, points: InferencePoints) -> FieldValues:
    """Field and its first two derivatives at X*, through the grid's separability where most of it is in use."""
    if len(points) < points.grid.n_points / 2:
        return field_map.evaluate(points.positions, 2)
    values, rows = field_map.on_grid(points.grid, 2, with_variance=False).values, points.cells
    assert values.gradient is not None
    assert values.second is not None
    return FieldValues(values.field[rows], values.gradient[rows], values.second[rows])


def _cells_in_use(field_map: FieldMap, spacing: float, config: FeatureConfig) -> tuple[RegularGrid, Indices | None]:
    """Grid over the samples, and which of its points lie near the path; None for all, where they cover a region."""
    region = field_map.grid_over(spacing)
    if config.grid == "region":
        return region, None
    around = field_map.grid_over(spacing, margin=config.path_radius * spacing)
    near_path = _cells_near(field_map.survey.positions, around, config.path_radius)
    if config.grid == "path":
        return around, near_path
    _, is_inside = region.nearest(_cell_positions(around, near_path))
    is_region = np.count_nonzero(is_inside) >= REGION_SHARE * region.n_points
    return (region, None) if is_region else (around, near_path)


def _n_points(grid: RegularGrid, near_path: Indices | None) -> int:
    return grid.n_points if near_path is None else len(near_path)


def _cells_near(samples: Points, grid: RegularGrid, radius: float) -> Indices:
    """Grid points within a radius (in spacings) of the grid point nearest to a sample."""
    visited, is_inside = grid.nearest(samples)
    visited = np.unique(visited[is_inside])
    ijk = np.stack(np.unravel_index(visited, grid.shape), axis=1)
    offsets, shape = ball_offsets(radius), np.asarray(grid.shape)
    near = []
    step = _CELLS_AT_ONCE // len(offsets) + 1
    for start in range(0, len(ijk), step):
        moved = (ijk[start : start + step, None] + offsets).reshape(-1, 3)
        moved = moved[np.all((moved >= 0) & (moved < shape), axis=1)]
        near.append(np.unique(np.ravel_multi_index(tuple(moved.T), grid.shape)))
    return np.unique(np.concatenate(near)).astype(np.int64)


def _cell_positions(grid: RegularGrid, cells: Indices) -> Points:
    ijk = np.stack(np.unravel_index(cells, grid.shape), axis=1)
    return transform_points(ijk * grid.spacing, grid.T_map_grid)
