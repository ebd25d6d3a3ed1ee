"""Claims about regular grids."""

import numpy as np
import pytest

from magmatch.grid import RegularGrid, distinct_cells


def test_grid_covers_the_points_and_keeps_its_spacing():
    rng = np.random.default_rng(0)
    points = rng.uniform(size=(50, 3)) * [3, 2, 0.5]
    grid = RegularGrid.over(points, 0.25, margin=0.1)
    p = grid.points()
    assert np.all(p.min(axis=0) <= points.min(axis=0) - 0.1 + 1e-12)
    assert np.all(p.max(axis=0) >= points.max(axis=0) + 0.1 - 1e-12)
    np.testing.assert_allclose(np.diff(grid.axes[0]), 0.25)
    assert p.shape == (grid.n_points, 3)


@pytest.mark.parametrize("extent", [3, 2**40])
def test_distinct_cells_are_those_that_numpy_finds(extent):
    cells = np.repeat(np.random.default_rng(1).integers(-extent, extent, (40, 3)), 2, axis=0)
    np.testing.assert_array_equal(distinct_cells(cells), np.unique(cells, axis=0))


def test_nearest_point_is_found_and_outside_is_said():
    grid = RegularGrid.over(np.random.default_rng(2).uniform(size=(20, 3)), 0.2)
    index, is_inside = grid.nearest(grid.points() + 0.05)
    assert is_inside.all()
    np.testing.assert_array_equal(index, np.arange(grid.n_points))
    assert not grid.nearest(np.array([[10.0, 0, 0]]))[1].any()


def test_a_single_point_makes_a_grid_of_one():
    grid = RegularGrid.over(np.array([[1.0, 2.0, 3.0]]), 0.5)
    assert grid.shape == (1, 1, 1)
    np.testing.assert_allclose(grid.points(), [[1, 2, 3]])
