# SPDX-License-Identifier: BSD-3-Clause
"""A regular grid of points with its pose in a map; grids of points and cells in general."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.spatial.transform import RigidTransform

from magmatch.arguments import number_of, points_of
from magmatch.geometry import transform_points
from magmatch.typing import Indices, Mask, Points, Scalars


def spanned_points(axes: Sequence[np.ndarray]) -> np.ndarray:
    """All points of the grid that three axes span, (n, 3), in C order (last axis fastest)."""
    return np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1).reshape(-1, 3)


def distinct_cells(cells: np.ndarray) -> np.ndarray:
    """Distinct rows of whole numbers (n, 3), ascending; sorted as single numbers where these fit: much faster."""
    low = cells.min(axis=0)
    sizes = [int(size) for size in cells.max(axis=0) - low + 1]
    if sizes[0] * sizes[1] * sizes[2] >= 2**62:
        return np.asarray(np.unique(cells, axis=0))
    flat = np.unique(np.ravel_multi_index(tuple((cells - low).T), tuple(sizes)))
    return np.asarray(np.stack(np.unravel_index(flat, tuple(sizes)), axis=1) + low)


@dataclass(frozen=True, eq=False, slots=True)
class RegularGrid:
    """Points at equal spacing along three axes, in C order (last axis fastest).

    Attributes
    ----------
    T_map_grid : RigidTransform
        Takes grid coordinates to map coordinates; its translation is the position of point (0, 0, 0). Grids rotate
        with their survey, so that what is computed on them does not depend on the frame.
    spacing : float, m
        Distance of neighbouring points, equal along the axes.
    shape : (int, int, int)
        Number of points along each axis.
    """

    T_map_grid: RigidTransform
    spacing: float
    shape: tuple[int, int, int]

    @property
    def n_points(self) -> int:
        """Number of points."""
        return int(np.prod(self.shape))

    @property
    def axes(self) -> tuple[Scalars, Scalars, Scalars]:
        """Coordinates along each axis in the grid's own frame, m."""
        x, y, z = (self.spacing * np.arange(n, dtype=np.float64) for n in self.shape)
        return x, y, z

    def local_points(self) -> Points:
        """All points in the grid's own frame: (n_points, 3), m."""
        return spanned_points(self.axes)

    def points(self) -> Points:
        """All points in the map's frame: (n_points, 3), m."""
        return transform_points(self.local_points(), self.T_map_grid)

    def nearest(self, p_map: Points) -> tuple[Indices, Mask]:
        """Index of the nearest grid point, and whether a point lies within half a spacing of the grid.

        Parameters
        ----------
        p_map : (n, 3) array, m
            Points in the map's frame.

        Returns
        -------
        index : (n,) array
            Flat index in C order (0 where outside).
        is_inside : (n,) array
            False where the nearest point would lie outside the grid.
        """
        ijk = np.rint(transform_points(p_map, self.T_map_grid.inv()) / self.spacing).astype(np.int64)
        is_inside = np.all((ijk >= 0) & (ijk < np.asarray(self.shape)), axis=1)
        ijk = np.where(is_inside[:, None], ijk, 0)
        return np.ravel_multi_index(tuple(ijk.T), self.shape).astype(np.int64), is_inside

    @classmethod
    def over(
        cls, points: Points, spacing: float, margin: float = 0.0, T_map_grid: RigidTransform | None = None
    ) -> "RegularGrid":
        """Lay a grid over the bounding box of points.

        Parameters
        ----------
        points : (n, 3) array, m
            Points in the map's frame that the grid must cover.
        spacing : float, m
            Distance of neighbouring grid points.
        margin : float, m
            How far the grid reaches beyond the points' box on every side.
        T_map_grid : RigidTransform, optional
            Orientation of the grid's axes in the map (its translation is ignored); the map's own axes by default.

        Returns
        -------
        RegularGrid
            Centred over the box, at least one point along every axis.
        """
        number_of(spacing, "spacing", "m", is_positive=True)
        number_of(margin, "margin", "m")
        points = points_of(points)
        frame = RigidTransform.identity() if T_map_grid is None else T_map_grid
        local = transform_points(points, frame.inv())
        low, high = local.min(axis=0) - margin, local.max(axis=0) + margin
        n = np.maximum(np.ceil((high - low) / spacing - 1e-9).astype(int) + 1, 1)
        origin = (low + high - (n - 1) * spacing) / 2
        return cls(frame * RigidTransform.from_translation(origin), float(spacing), (int(n[0]), int(n[1]), int(n[2])))
