# SPDX-License-Identifier: BSD-3-Clause
"""A map answers alike however it is asked: at points, on grids, in a table, and in any frame."""

import pickle

import numpy as np
import pytest

from magmatch.field.axis_grid import map_on_grid
from magmatch.field.build import build_map
from magmatch.field.map import FieldMap
from magmatch.field.query import query_map
from magmatch.geometry import random_transform, rotate_vectors, transform_points
from magmatch.grid import RegularGrid

T = random_transform(np.random.default_rng(5))


@pytest.fixture(scope="module")
def boxed(small_map):
    """The same map, declared for a box."""
    return build_map(
        small_map.survey, small_map.config.model_copy(update={"domain": (0.2, 0.2, -1.0, 0.8, 0.8, 1.0)})
    )


@pytest.fixture(scope="module")
def there(small_map):
    return small_map.transformed(T)


@pytest.mark.parametrize("is_aligned", [True, False])
def test_a_grid_says_what_its_points_do(there, is_aligned):
    grid = there.grid_over(0.3, 0.1)
    if not is_aligned:
        grid = RegularGrid(random_transform(np.random.default_rng(2)) * grid.T_map_grid, grid.spacing, grid.shape)
    points, found = grid.points(), there.on_grid(grid, 2)
    expected = there.evaluate(points, 2)
    for name in ("field", "gradient", "second"):
        value = getattr(expected, name)
        np.testing.assert_allclose(getattr(found.values, name), value, atol=1e-9 * np.abs(value).max())
    variance = np.trace(there.covariance(points), axis1=1, axis2=2) / 3
    np.testing.assert_allclose(found.variance, variance, rtol=1e-6)
    np.testing.assert_array_equal(found.is_known, there.knows(points))
    assert np.isnan(there.on_grid(grid, 0, with_variance=False).variance).all()


def test_a_table_says_what_its_points_do_however_many_are_asked_at_a_time(there, monkeypatch):
    points = transform_points(np.random.default_rng(1).uniform(-0.2, 1.2, (23, 3)), T)
    monkeypatch.setattr("magmatch.field.query.CHUNK", 7)
    table = query_map(there, points, with_gradient=True)
    values, covariance = there.evaluate(points, 1), there.covariance(points)
    for k, axis in enumerate("xyz"):
        np.testing.assert_array_equal(table[axis], points[:, k])
        np.testing.assert_allclose(table[f"b{axis}"], values.field[:, k], rtol=1e-9)
        np.testing.assert_allclose(table[f"s{axis}"], np.sqrt(covariance[:, k, k]), rtol=1e-6)
        for m, other in enumerate("xyz"):
            np.testing.assert_allclose(table[f"b{axis}{other}"], values.gradient[:, k, m], rtol=1e-6, atol=1e-12)
    assert list(query_map(there, points)) == [f"{kind}{axis}" for kind in ("", "b", "s") for axis in "xyz"]


def test_a_grid_for_other_programs_is_the_same_in_parts(there, monkeypatch):
    whole = map_on_grid(there, 0.4)
    monkeypatch.setattr("magmatch.field.axis_grid.CHUNK", 11)
    parts = map_on_grid(there, 0.4)
    np.testing.assert_allclose(parts.field, whole.field, rtol=1e-12)
    np.testing.assert_allclose(parts.sd, whole.sd, rtol=1e-9)
    np.testing.assert_array_equal(parts.is_known, whole.is_known)


def test_draws_turn_with_the_map_and_scatter_about_its_mean(small_map, there):
    points = np.random.default_rng(3).uniform(0, [1.5, 1.0, 0.4], (5, 3))
    drawn, moved = (
        m.draw(p, 300, 1, np.random.default_rng(4))
        for m, p in ((small_map, points), (there, transform_points(points, T)))
    )
    np.testing.assert_allclose(moved[7].field, rotate_vectors(drawn[7].field, T), rtol=1e-6)
    with pytest.raises(ValueError, match="order"):
        small_map.draw(points, 1, 3, np.random.default_rng(4))
    off = np.array([d.field for d in drawn]) - small_map.evaluate(points).field
    covariance = small_map.covariance(points)
    for k in range(5):
        sd = np.sqrt(np.diag(covariance[k]))
        np.testing.assert_allclose(
            off[:, k].T @ off[:, k] / 300 / np.outer(sd, sd), covariance[k] / np.outer(sd, sd), atol=0.35
        )


def test_a_map_that_was_pickled_says_the_same(there):
    again = pickle.loads(pickle.dumps(there))
    points = there.survey.positions[:40]
    # A transform is brought to the nearest one whenever it is unpickled.
    np.testing.assert_allclose(again.evaluate(points, 1).field, there.evaluate(points, 1).field, rtol=1e-12)
    np.testing.assert_allclose(again.covariance(points), there.covariance(points), rtol=1e-9)


def test_within_its_declared_box_a_map_is_as_ever_and_outside_the_prior_returns(small_map, boxed):
    points = np.array([[0.5, 0.5, 0.1], [0.9, 0.5, 0.1]])
    np.testing.assert_array_equal(boxed.evaluate(points[:1]).field, small_map.evaluate(points[:1]).field)
    np.testing.assert_array_equal(boxed.knows(points), [True, False])
    nowhere = small_map.covariance(np.full((1, 3), 1e6))
    np.testing.assert_allclose(boxed.covariance(points[1:]), nowhere)


def test_the_box_moves_with_its_map_and_is_saved_with_it(boxed, tmp_path):
    points = np.random.default_rng(2).uniform(size=(100, 3))
    boxed.transformed(T).save(tmp_path / "map")
    for moved in (boxed.transformed(T), FieldMap.load(tmp_path / "map")):
        np.testing.assert_array_equal(moved.knows(transform_points(points, T)), boxed.knows(points))
