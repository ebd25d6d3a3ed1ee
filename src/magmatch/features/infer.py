# SPDX-License-Identifier: BSD-3-Clause
"""`infer`: the field and its derivatives at X*, the points of a regular grid within the measurements."""

from dataclasses import dataclass

import numpy as np
from scipy.spatial import cKDTree
from scipy.spatial.transform import RigidTransform, Rotation

from magmatch.errors import ConfigurationError
from magmatch.features.config import FeatureConfig
from magmatch.field.cholesky.cells import ball_offsets
from magmatch.field.map import FieldMap
from magmatch.field.values import FieldValues
from magmatch.geometry import in_hull, rotation_matrix, transform_points
from magmatch.grid import RegularGrid
from magmatch.progress import tell
from magmatch.typing import Indices, Points, Scalars, Vectors

# Where less of the samples' hull than this lies near a sample, the survey is a path, not a region.
REGION_SHARE = 0.5
# A survey whose thickness is below this share of its breadth is flat: its normal is known better than any axis that
# its frame happens to have, so one axis of the grid follows it.
FLAT = 0.2
# Cells spread around the path at once: bounds memory.
_CELLS_AT_ONCE = 2_000_000


@dataclass(frozen=True, eq=False, slots=True)
class Inferred:
    """The field that a map infers at X*.

    Attributes
    ----------
    field_map : FieldMap
        What inferred it.
    grid : RegularGrid
        The grid that X* are points of, over the samples' box.
    cells : (n,) array
        Flat indices (C order) of the grid points in use, increasing.
    positions : (n, 3) array, m, map frame
    values : FieldValues
        Field, first and second derivatives at X*, map frame.
    """

    field_map: FieldMap
    grid: RegularGrid
    cells: Indices
    positions: Points
    values: FieldValues

    def __len__(self) -> int:
        return len(self.cells)

    def __repr__(self) -> str:
        return f"Inferred({len(self)} points {self.spacing:.3g} m apart, of {self.field_map.survey.name!r})"

    @property
    def field(self) -> Vectors:
        """Field at X*, T, map frame."""
        return self.values.field

    @property
    def spacing(self) -> float:
        """Distance of neighbouring points, m."""
        return self.grid.spacing

    def support(self, rows: Indices, radius: float) -> tuple[np.ndarray, Scalars]:
        """Points around some rows: (k, s) rows at s offsets (-1: not in X*), and their lengths in spacings."""
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

    def variance(self, rows: Indices) -> Scalars:
        """Mean posterior variance of the components of the field at some rows: (k,), T^2."""
        covariance = self.field_map.covariance(self.positions[rows])
        return np.asarray(np.trace(covariance, axis1=1, axis2=2) / 3)


def infer(field_map: FieldMap, config: FeatureConfig | None = None) -> Inferred:
    """Infer the field and its derivatives at X*, a regular grid bounded by the measurements.

    Parameters
    ----------
    field_map : FieldMap
        A fitted map.
    config : FeatureConfig, optional
        Where X* lies; `FeatureConfig.spacing` is used as it is.

    Returns
    -------
    Inferred
        In the map's frame; without points where the map knows none.

    Raises
    ------
    ConfigurationError
        The stated spacing needs more points than `FeatureConfig.max_points`.
    """
    config = config or FeatureConfig()
    spacing = grid_spacing(field_map, config)
    grid, cells = cells_in_use(field_map, spacing, config)
    positions = _cell_positions(grid, cells)
    is_known = field_map.knows(positions)
    cells, positions = cells[is_known], positions[is_known]
    tell(f"asking the map at {len(cells)} points, {spacing:.3g} m apart")
    return Inferred(field_map, grid, cells, positions, field_map.evaluate(positions, 2))


def grid_spacing(field_map: FieldMap, config: FeatureConfig) -> float:
    """Distance of the points of X*: as stated, or from the lengthscale and the bound on their number, m."""
    spacing = config.spacing or config.spacing_in_lengthscales * field_map.hyperparameters.lengthscale
    while (n_points := len(cells_in_use(field_map, spacing, config)[1])) > config.max_points:
        if config.spacing:
            msg = (
                f"spacing: {spacing:g} m needs {n_points} inference points in {field_map.survey.name!r}, expected at "
                f"most max_points = {config.max_points}; widen one or raise the other"
            )
            raise ConfigurationError(msg)
        spacing *= float(max((n_points / config.max_points) ** (1 / 3), 1.02))
    return spacing


def cells_in_use(field_map: FieldMap, spacing: float, config: FeatureConfig) -> tuple[RegularGrid, Indices]:
    """Grid over the samples, and which of its points lie within their hull, or near the path."""
    samples = field_map.survey.positions
    T_map_axes = RigidTransform.from_rotation(grid_axes(field_map, config))
    region = RegularGrid.over(_in_layers(samples, spacing, T_map_axes), spacing, 0.0, T_map_axes)
    hull = _cells_in_hull(region, samples)
    if config.grid == "region":
        return region, hull
    reach = config.path_radius * spacing
    if config.grid == "auto" and len(hull):
        distance = cKDTree(samples).query(_cell_positions(region, hull), distance_upper_bound=reach)[0]
        if np.count_nonzero(np.isfinite(distance)) >= REGION_SHARE * len(hull):
            return region, hull
    around = RegularGrid.over(samples, spacing, reach, T_map_axes)
    return around, _cells_near(samples, around, config.path_radius)


def grid_axes(field_map: FieldMap, config: FeatureConfig) -> Rotation:
    """Axes of the grid in the map: the survey's own, or its principal ones, which turn with it.

    Where the survey is flat, its own are turned by the least angle that brings one of them onto its normal.
    """
    if config.axes == "principal":
        return field_map.T_map_model.rotation
    survey = field_map.survey
    principal = rotation_matrix(survey.principal_frame())
    extents = np.ptp(survey.positions @ principal, axis=0)
    if extents[2] > FLAT * extents[1]:
        return Rotation.identity()
    normal = principal[:, 2]
    k = int(np.argmax(np.abs(normal)))
    axis = np.sign(normal[k]) * np.eye(3)[k]
    turn = np.cross(axis, normal)
    sine = float(np.linalg.norm(turn))
    angle = float(np.arctan2(sine, axis @ normal))
    return Rotation.from_rotvec(turn * (angle / sine)) if sine > 0 else Rotation.identity()


def _in_layers(samples: Points, spacing: float, T_map_axes: RigidTransform) -> Points:
    """Samples with each extent below a spacing taken for none, so that the grid has one layer in its middle."""
    local = transform_points(samples, T_map_axes.inv())
    middle, is_thin = (local.min(axis=0) + local.max(axis=0)) / 2, np.ptp(local, axis=0) < spacing
    return transform_points(np.where(is_thin, middle, local), T_map_axes)


def _cells_in_hull(grid: RegularGrid, samples: Points) -> Indices:
    """Grid points within the convex hull of the samples; along axes with one layer, of what lies across."""
    is_wide = np.array(grid.shape) > 1
    local = transform_points(samples, grid.T_map_grid.inv())[:, is_wide]
    points = grid.local_points()[:, is_wide]
    if is_wide.sum() < 2:
        return np.arange(len(points), dtype=np.int64)
    return np.flatnonzero(in_hull(points, local)).astype(np.int64)


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
