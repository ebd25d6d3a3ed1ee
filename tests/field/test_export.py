# SPDX-License-Identifier: BSD-3-Clause
"""A map as VTK, PLY and NetCDF, read by VTK and xarray."""

import numpy as np
import pytest

from magmatch.data.survey import Survey
from magmatch.errors import ConfigurationError
from magmatch.field.axis_grid import map_on_grid, write_netcdf, write_ply_cloud, write_vtk
from magmatch.field.hyperparameters import Hyperparameters
from magmatch.field.values import FieldValues


@pytest.fixture(scope="module")
def grid(small_map):
    return map_on_grid(small_map, 0.12)


def test_vtk_reads_the_grid(grid, tmp_path):
    vtk = pytest.importorskip("vtk")
    from vtk.util.numpy_support import vtk_to_numpy

    write_vtk(grid, tmp_path / "map.vtk")
    reader = vtk.vtkStructuredPointsReader()
    reader.SetFileName(str(tmp_path / "map.vtk"))
    reader.ReadAllVectorsOn()
    reader.ReadAllScalarsOn()
    reader.Update()
    image = reader.GetOutput()
    assert image.GetDimensions() == grid.field.shape[:3]
    np.testing.assert_allclose(image.GetOrigin(), [axis[0] for axis in grid.axes])
    field = vtk_to_numpy(image.GetPointData().GetArray("field"))
    number = image.ComputePointId([2, 1, 3])
    np.testing.assert_array_equal(field[number], grid.field[2, 1, 3])
    np.testing.assert_allclose(image.GetPoint(number), [grid.axes[0][2], grid.axes[1][1], grid.axes[2][3]])


def test_xarray_reads_the_grid_and_a_slice(small_map, grid, tmp_path):
    xr = pytest.importorskip("xarray")
    write_netcdf(grid, tmp_path / "map.nc", "hall")
    with xr.open_dataset(tmp_path / "map.nc", engine="scipy") as dataset:
        np.testing.assert_array_equal(dataset.bz.transpose("x", "y", "z"), grid.field[..., 2])
        assert dataset.bx.units == "T"
        assert dataset.attrs["frame"] == "hall"
    cut = map_on_grid(small_map, 0.1, ("z", 0.2))
    write_netcdf(cut, tmp_path / "cut.nc", "hall")
    with xr.open_dataset(tmp_path / "cut.nc", engine="scipy") as dataset:
        assert dataset.bx.dims == ("x", "y")
        assert float(dataset.z) == pytest.approx(0.2)


def test_ply_holds_the_points_the_map_knows(grid, tmp_path):
    write_ply_cloud(grid, tmp_path / "map.ply")
    head, _, body = (tmp_path / "map.ply").read_bytes().partition(b"end_header\n")
    n = int(grid.is_known.sum())
    assert f"element vertex {n}\n".encode() in head
    assert len(body) == n * 9 * 8


def test_a_grid_of_billions_is_refused(small_map):
    with pytest.raises(ConfigurationError, match="larger one"):
        map_on_grid(small_map, 1e-4)


class Anything:
    """A map of a box whose field is its place, with a lengthscale far below what a grid of it could resolve."""

    hyperparameters = Hyperparameters(1e-4, 1e-6, 1e-7, 1e-4)

    def __init__(self, size):
        corners = np.array([1.0, 2.0, -3.0]) + np.array([[0, 0, 0], size])
        self.survey = Survey(corners, np.ones((2, 3)))

    def evaluate(self, points):
        return FieldValues(1e-6 * points)

    def covariance(self, points):
        return np.tile(np.diag([1.0, 4.0, 9.0]), (len(points), 1, 1))

    def knows(self, points):
        return points[:, 0] > 1.5


@pytest.mark.parametrize("size", [(2.0, 3.0, 0.5), (4.0, 0.2, 0.0), (5.0, 0.0, 0.0)])
def test_a_default_grid_has_about_a_hundred_thousand_points_whatever_the_shape(size):
    grid = map_on_grid(Anything(size))
    assert 60_000 < grid.is_known.size < 150_000
    i, j, k = (n // 3 for n in grid.is_known.shape)
    point = [axis[n] for axis, n in zip(grid.axes, (i, j, k), strict=True)]
    np.testing.assert_allclose(grid.field[i, j, k], 1e-6 * np.array(point), rtol=1e-9)
    np.testing.assert_allclose(grid.sd[i, j, k], [1, 2, 3])
    assert grid.is_known[i, j, k] == (point[0] > 1.5)
    for axis, low, high in zip(grid.axes, (1.0, 2.0, -3.0), size, strict=True):
        assert axis[0] <= low + 1e-9
        assert axis[-1] >= low + high - 1e-9
        np.testing.assert_allclose(np.diff(axis), grid.spacing, rtol=1e-6)
