"""Claims about maps that are declared for a box."""

import numpy as np
import pytest

from magmatch.data.survey import Survey
from magmatch.field.build import build_map
from magmatch.field.config import FieldConfig
from magmatch.field.map import FieldMap
from magmatch.geometry import random_transform, transform_points

BOX = (0.2, 0.2, -1.0, 0.8, 0.8, 1.0)


@pytest.fixture(scope="module")
def bounded():
    rng = np.random.default_rng(0)
    x = rng.uniform(size=(150, 3)) * [1, 1, 0.3]
    b = 1e-6 * np.stack([20 + x[:, 1], 3 + x[:, 0], -45 + 0 * x[:, 0]], axis=1)
    config = {"prior": "spline", "lengthscale": 0.6, "signal_sd": 1e-6, "noise_sd": 1e-7, "spacing": 0.3}
    return build_map(Survey(x, b), FieldConfig(**config)), build_map(Survey(x, b), FieldConfig(domain=BOX, **config))


def test_inside_the_box_nothing_changes_and_outside_the_prior_returns(bounded):
    free, boxed = bounded
    points = np.array([[0.5, 0.5, 0.1], [0.9, 0.5, 0.1]])
    np.testing.assert_array_equal(boxed.evaluate(points[:1]).field, free.evaluate(points[:1]).field)
    np.testing.assert_array_equal(boxed.knows(points), [True, False])
    nowhere = free.covariance(np.full((1, 3), 1e6))
    np.testing.assert_allclose(boxed.covariance(points[1:]), nowhere)


def test_the_box_moves_with_its_map_and_is_saved_with_it(bounded, tmp_path):
    _, boxed = bounded
    T = random_transform(np.random.default_rng(1))
    moved = boxed.transformed(T)
    points = np.random.default_rng(2).uniform(size=(100, 3))
    np.testing.assert_array_equal(moved.knows(transform_points(points, T)), boxed.knows(points))
    moved.save(tmp_path / "map")
    again = FieldMap.load(tmp_path / "map")
    np.testing.assert_array_equal(again.knows(transform_points(points, T)), boxed.knows(points))
