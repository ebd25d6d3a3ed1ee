# SPDX-License-Identifier: BSD-3-Clause
"""A map as a grid for other programs: VTK and PLY for ParaView, NetCDF for xarray and GIS."""

from pathlib import Path

import numpy as np

from magmatch.atomic import atomic_write
from magmatch.data.points import write_ply, write_vtk_grid
from magmatch.field.axis_grid import MapGrid


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
    """Write a grid as NetCDF (version 3, by SciPy) with coordinates, units and names; needs the extra ``grid``.

    An axis of one point is kept as a coordinate without a dimension: a slice has two dimensions.
    """
    content = bytes(grid.to_xarray(frame).to_netcdf(engine="scipy"))
    with atomic_write(path) as stream:
        stream.write(content)
