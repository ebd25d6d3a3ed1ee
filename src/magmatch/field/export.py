# SPDX-License-Identifier: BSD-3-Clause
"""A map as a grid for other programs: VTK and PLY for ParaView, NetCDF for xarray and GIS."""

from dataclasses import dataclass
from pathlib import Path

import numpy as np

from magmatch.atomic import atomic_write
from magmatch.data.points import write_ply, write_vtk_grid
from magmatch.errors import ConfigurationError, MissingExtraError
from magmatch.field.map import FieldMap
from magmatch.grid import RegularGrid
from magmatch.typing import Scalars

# Points evaluated at a time; bounds the memory whatever the number of points.
CHUNK = 20_000
# A grid that nobody chose; and one that is refused, since it would take hours and gigabytes.
DEFAULT_POINTS, MAX_POINTS = 100_000, 20_000_000


@dataclass(frozen=True, eq=False, slots=True)
class MapGrid:
    """A map on a grid along the axes of its frame.

    Attributes
    ----------
    axes : three (n,) arrays, m
        Coordinates along x, y, z.
    spacing : float, m
    field, sd : (nx, ny, nz, 3) arrays, T
        Field and standard deviation of its components.
    is_known : (nx, ny, nz) bool array
        Where the map has data nearby.
    """

    axes: tuple[Scalars, Scalars, Scalars]
    spacing: float
    field: np.ndarray
    sd: np.ndarray
    is_known: np.ndarray

    def values(self) -> dict[str, np.ndarray]:
        """What VTK and NetCDF hold, by name."""
        magnitude = np.linalg.norm(self.field, axis=-1)
        return {"field": self.field, "sd": self.sd, "magnitude": magnitude, "known": self.is_known.astype(np.float64)}


def map_on_grid(field_map: FieldMap, spacing: float | None = None, cut: tuple[str, float] | None = None) -> MapGrid:
    """Evaluate a map over the box of its samples.

    Parameters
    ----------
    field_map : FieldMap
    spacing : float, m, optional
        Distance of grid points; by default half a lengthscale, or more where that makes more than 100,000 points.
    cut : (str, float), optional
        Axis and coordinate (m) of a slice, such as ``("z", 1.0)``; the whole box by default.

    Returns
    -------
    MapGrid

    Raises
    ------
    ConfigurationError
        Too many points.
    """
    corners = np.array([field_map.survey.positions.min(axis=0), field_map.survey.positions.max(axis=0)])
    if cut is not None:
        corners[:, "xyz".index(cut[0])] = cut[1]
    if spacing is None:
        size = np.maximum(np.ptp(corners, axis=0), 1e-9)
        extent = np.prod(size[size > 1e-6]) ** (1 / max(1, int((size > 1e-6).sum())))
        coarsest = extent / DEFAULT_POINTS ** (1 / max(1, int((size > 1e-6).sum())))
        spacing = max(field_map.hyperparameters.lengthscale / 2, float(coarsest))
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
    with atomic_write(path) as stream:
        write_vtk_grid(stream, grid.axes, grid.spacing, grid.values())


def write_ply_cloud(grid: MapGrid, path: str | Path) -> None:
    """Write the points that the map knows as PLY, with ``bx, by, bz`` and ``sx, sy, sz``."""
    points = np.stack(np.meshgrid(*grid.axes, indexing="ij"), axis=-1)[grid.is_known]
    with atomic_write(path) as stream:
        write_ply(stream, points, {"b": grid.field[grid.is_known], "s": grid.sd[grid.is_known]})


def write_netcdf(grid: MapGrid, path: str | Path, frame: str) -> None:
    """Write a grid as NetCDF (version 3, by SciPy) with coordinates, units and names.

    Parameters
    ----------
    grid : MapGrid
        An axis of one point is kept as a coordinate without a dimension: a slice has two dimensions.
    path : path
    frame : str
        Name of the map's frame.

    Raises
    ------
    MissingExtraError
        Needs the extra ``grid``.
    """
    try:
        import xarray as xr
    except ImportError:
        feature = "writing NetCDF"
        raise MissingExtraError(feature, "grid") from None
    names, metre = ("x", "y", "z"), {"units": "m"}
    data = {}
    for k, axis in enumerate(names):
        data[f"b{axis}"] = (names, grid.field[..., k], {"units": "T", "long_name": f"magnetic flux density, {axis}"})
        data[f"s{axis}"] = (names, grid.sd[..., k], {"units": "T", "long_name": f"standard deviation of b{axis}"})
    data["magnitude"] = (names, np.linalg.norm(grid.field, axis=-1), {"units": "T"})
    data["known"] = (names, grid.is_known.astype(np.int8), {"long_name": "1 where the map has data nearby"})
    coordinates = {name: (name, axis, metre) for name, axis in zip(names, grid.axes, strict=True)}
    dataset = xr.Dataset(data, coordinates, {"Conventions": "CF-1.8", "title": "magmatch field map", "frame": frame})
    content = bytes(dataset.squeeze().to_netcdf(engine="scipy"))
    with atomic_write(path) as stream:
        stream.write(content)
