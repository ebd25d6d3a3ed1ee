# SPDX-License-Identifier: BSD-3-Clause
"""A map as a grid along the axes of its frame for other programs: xarray, VTK and PLY, NetCDF."""

from dataclasses import dataclass
from pathlib import Path
from typing import Any, Protocol

import numpy as np

from magmatch.arguments import found, number_of, points_of
from magmatch.atomic import atomic_write
from magmatch.data.points import write_ply, write_vtk_grid
from magmatch.data.survey import Survey
from magmatch.errors import ConfigurationError, import_extra
from magmatch.field.excess import FittedField
from magmatch.grid import RegularGrid, spanned_points
from magmatch.typing import Points, Scalars

# Points evaluated at a time; bounds the memory whatever the number of points.
CHUNK = 20_000
# A grid that nobody chose; and one that is refused, since it would take hours and gigabytes.
DEFAULT_POINTS, MAX_POINTS = 100_000, 20_000_000


class Mapped(FittedField, Protocol):
    """A map, as far as a grid asks it."""

    @property
    def survey(self) -> Survey:
        """Samples."""

    def covariance(self, points: Points) -> np.ndarray:
        """Covariance of the field at points."""


@dataclass(frozen=True, eq=False, slots=True)
class MapGrid:
    """A map on a grid along the axes of its frame."""

    axes: tuple[Scalars, Scalars, Scalars]  # each (n,), m: coordinates along x, y, z
    spacing: float  # m
    field: np.ndarray  # (nx, ny, nz, 3), T: field and standard deviation of its components
    sd: np.ndarray  # (nx, ny, nz, 3), T
    is_known: np.ndarray  # (nx, ny, nz): where the map has data nearby

    def to_xarray(self, frame: str) -> Any:
        """Give the grid as an xarray Dataset with units and names; an axis of one point is no dimension."""
        xr = import_extra("xarray", "a map as a grid of xarray or NetCDF", "grid")
        names, metre = ("x", "y", "z"), {"units": "m"}
        data = {}
        for k, axis in enumerate(names):
            data[f"b{axis}"] = (
                names,
                self.field[..., k],
                {"units": "T", "long_name": f"magnetic flux density, {axis}"},
            )
            data[f"s{axis}"] = (names, self.sd[..., k], {"units": "T", "long_name": f"standard deviation of b{axis}"})
        data["magnitude"] = (names, np.linalg.norm(self.field, axis=-1), {"units": "T"})
        data["known"] = (names, self.is_known.astype(np.int8), {"long_name": "1 where the map has data nearby"})
        coordinates = {name: (name, axis, metre) for name, axis in zip(names, self.axes, strict=True)}
        dataset = xr.Dataset(
            data, coordinates, {"Conventions": "CF-1.8", "title": "magmatch field map", "frame": frame}
        )
        return dataset.squeeze()


def map_on_grid(field_map: Mapped, spacing: float | None = None, cut: tuple[str, float] | None = None) -> MapGrid:
    """Evaluate a map over the box of its samples, or on a slice such as ``("z", 1.0)`` (m).

    The spacing (m) is by default half a lengthscale, or more where that makes more than 100,000 points; more points
    than are allowed raise `ConfigurationError`.
    """
    corners = np.array([field_map.survey.positions.min(axis=0), field_map.survey.positions.max(axis=0)])
    if cut is not None:
        if not isinstance(cut, tuple) or len(cut) != 2 or cut[0] not in ("x", "y", "z"):
            msg = f"cut: expected an axis and a coordinate in m such as ('z', 1.0), got {found(cut)}"
            raise ValueError(msg)
        points_of([[cut[1]] * 3], "cut")
        corners[:, "xyz".index(cut[0])] = cut[1]
    if spacing is None:
        size = np.maximum(np.ptp(corners, axis=0), 1e-9)
        extent = np.prod(size[size > 1e-6]) ** (1 / max(1, int((size > 1e-6).sum())))
        coarsest = extent / DEFAULT_POINTS ** (1 / max(1, int((size > 1e-6).sum())))
        spacing = max(field_map.hyperparameters.lengthscale / 2, float(coarsest))
    number_of(spacing, "spacing", "m", is_positive=True)
    n_points = float(np.prod(np.ceil(np.ptp(corners, axis=0) / spacing) + 1))
    if n_points > MAX_POINTS:
        msg = f"--spacing {spacing:g} makes {n_points:.3g} points, expected at most {MAX_POINTS}; choose a larger one"
        raise ConfigurationError(msg)
    grid = RegularGrid.over(corners, spacing)
    points = grid.points()
    parts = [points[start : start + CHUNK] for start in range(0, len(points), CHUNK)]
    field = np.concatenate([field_map.evaluate(part).field for part in parts])
    variance = np.concatenate([np.diagonal(field_map.covariance(part), axis1=1, axis2=2) for part in parts])
    known = np.concatenate([field_map.knows(part) for part in parts])
    x, y, z = (axis + shift for axis, shift in zip(grid.axes, grid.T_map_grid.translation, strict=True))
    shape = grid.shape
    sd = np.sqrt(np.maximum(variance, 0)).reshape(*shape, 3)
    return MapGrid((x, y, z), float(spacing), field.reshape(*shape, 3), sd, known.reshape(shape))


def write_vtk(grid: MapGrid, path: str | Path) -> None:
    """Write a grid as legacy VTK (structured points, binary)."""
    magnitude, known = np.linalg.norm(grid.field, axis=-1), grid.is_known.astype(np.float64)
    values = {"field": grid.field, "sd": grid.sd, "magnitude": magnitude, "known": known}
    with atomic_write(path) as stream:
        write_vtk_grid(stream, grid.axes, grid.spacing, values)


def write_ply_cloud(grid: MapGrid, path: str | Path) -> None:
    """Write the points that the map knows as PLY, with ``bx, by, bz`` and ``sx, sy, sz``."""
    points = spanned_points(grid.axes)[grid.is_known.ravel()]
    with atomic_write(path) as stream:
        write_ply(stream, points, {"b": grid.field[grid.is_known], "s": grid.sd[grid.is_known]})


def write_netcdf(grid: MapGrid, path: str | Path, frame: str) -> None:
    """Write a grid as NetCDF (version 3, by SciPy) with coordinates, units and names; needs the extra ``grid``.

    An axis of one point is kept as a coordinate without a dimension: a slice has two dimensions.
    """
    content = bytes(grid.to_xarray(frame).to_netcdf(engine="scipy"))
    with atomic_write(path) as stream:
        stream.write(content)
