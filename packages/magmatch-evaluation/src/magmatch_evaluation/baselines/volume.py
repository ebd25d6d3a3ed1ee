# SPDX-License-Identifier: BSD-3-Clause
"""The field's magnitude in a box: what a method for images or point clouds gets to see of a map."""

from dataclasses import dataclass, replace

import numpy as np
from scipy.ndimage import map_coordinates
from scipy.spatial.transform import RigidTransform, Rotation

from magmatch.features.config import FeatureConfig
from magmatch.features.infer import cells_in_use, grid_spacing
from magmatch.field.map import FieldMap
from magmatch.geometry import transform_points
from magmatch.grid import RegularGrid
from magmatch.typing import Mask, Points, Scalars, Vector3


@dataclass(frozen=True, eq=False, slots=True)
class Volume:
    """Magnitude (T) of the field on a grid over the samples (m, map frame), and where it is known."""

    grid: RegularGrid
    magnitude: np.ndarray
    is_known: np.ndarray
    samples: Points

    def at(self, p_map: Points) -> tuple[Scalars, Mask]:
        """Magnitude at points by interpolation, and whether it is known there."""
        ijk = transform_points(p_map, self.grid.T_map_grid.inv()).T / self.grid.spacing
        inside = np.all((ijk > -0.5) & (ijk < np.array(self.grid.shape)[:, None] - 0.5), axis=0)
        value = map_coordinates(self.magnitude, ijk, order=1, mode="nearest")
        known = map_coordinates(self.is_known.astype(np.float64), ijk, order=0, mode="constant") > 0.5
        return np.asarray(value, dtype=np.float64), np.asarray(inside & known)


@dataclass(frozen=True, eq=False, slots=True)
class Layer:
    """An image of the magnitude (rows, columns), T, on a plane; `T_map_image` takes (column, row, 0), m."""

    magnitude: np.ndarray
    is_known: np.ndarray
    T_map_image: RigidTransform
    pixel: float

    def points(self, columns_rows: np.ndarray) -> Points:
        """Where pixels (column, row), fractions allowed, lie in the map: (n, 3), m."""
        flat = np.column_stack([self.pixel * columns_rows, np.zeros(len(columns_rows))])
        return transform_points(flat.astype(np.float64), self.T_map_image)


def magnitude_volume(field_map: FieldMap, spacing: float) -> Volume:
    """Evaluate a map's magnitude on a grid of a spacing (m) over its samples."""
    grid = field_map.grid_over(spacing)
    gridded = field_map.on_grid(grid, order=0, with_variance=False)
    magnitude = np.linalg.norm(gridded.values.field, axis=1).reshape(grid.shape)
    return Volume(grid, magnitude, gridded.is_known.reshape(grid.shape), field_map.survey.positions)


def within_measurements(volume: Volume, field_map: FieldMap) -> Volume:
    """Take as known only what is nearest to a point of the published method's X*, all within the measurements."""
    config = FeatureConfig()
    grid, cells = cells_in_use(field_map, grid_spacing(field_map, config), config)
    nearest, is_inside = grid.nearest(volume.grid.points())
    is_near = (is_inside & np.isin(nearest, cells)).reshape(volume.grid.shape)
    return replace(volume, is_known=volume.is_known & is_near)


def shared_spacing(base_map: FieldMap, target_map: FieldMap, per_lengthscale: float, max_points: int) -> float:
    """Grid spacing (m): a part of the shorter lengthscale, coarser where a grid would have too many points."""
    spacing = min(m.hyperparameters.lengthscale for m in (base_map, target_map)) / per_lengthscale
    while max(m.grid_over(spacing).n_points for m in (base_map, target_map)) > max_points:
        spacing *= 1.1
    return spacing


def cut_layers(volume: Volume, normal: Vector3, gap: float, max_layers: int) -> list[Layer]:
    """Cut a volume into parallel images that look along a unit vector, one where the samples lie in a plane.

    Neighbouring images lie `gap` (m) apart, wider where there would be too many.
    """
    # Third axis along the normal; of z it is the identity.
    T_map_cut = RigidTransform.from_rotation(Rotation.align_vectors(normal[None], [[0.0, 0.0, 1.0]])[0])
    local = transform_points(volume.samples, T_map_cut.inv())
    low, high = local.min(axis=0), local.max(axis=0)
    n_layers = int(np.clip((high[2] - low[2]) // gap, 1, max_layers))
    pixel = volume.grid.spacing
    shape = np.ceil((high[:2] - low[:2]) / pixel).astype(int) + 1
    columns, rows = np.meshgrid(pixel * np.arange(shape[0]), pixel * np.arange(shape[1]))
    flat = np.column_stack([columns.ravel(), rows.ravel(), np.zeros(columns.size)])
    layers = []
    for k in range(n_layers):
        height = low[2] + (k + 0.5) * (high[2] - low[2]) / n_layers
        T_map_image = T_map_cut * RigidTransform.from_translation([low[0], low[1], height])
        magnitude, is_known = volume.at(transform_points(flat, T_map_image))
        layers.append(Layer(magnitude.reshape(columns.shape), is_known.reshape(columns.shape), T_map_image, pixel))
    return layers


def level_points(volume: Volume, level: float) -> Points:
    """Points (m, map frame) of a surface of equal magnitude (T), one on each edge of the grid that crosses it."""
    above, parts = volume.magnitude - level, []
    for axis in range(3):
        first = np.take(above, range(above.shape[axis] - 1), axis)
        second = np.take(above, range(1, above.shape[axis]), axis)
        known = np.take(volume.is_known, range(above.shape[axis] - 1), axis)
        known = known & np.take(volume.is_known, range(1, above.shape[axis]), axis)
        crossed = np.argwhere((first * second < 0) & known)
        one, other = first[tuple(crossed.T)], second[tuple(crossed.T)]
        at = crossed.astype(np.float64)
        at[:, axis] += one / (one - other)
        parts.append(at)
    return transform_points(volume.grid.spacing * np.concatenate(parts), volume.grid.T_map_grid)
