# SPDX-License-Identifier: BSD-3-Clause
"""What no map explains: dense least squares with the map's own basis, and its slope against differences."""

from dataclasses import replace

import numpy as np
import pytest

from hand_made import EARTH, box, some_field
from magmatch.field.hyperparameters import Hyperparameters
from magmatch.field.spline.spline_model import SplineModel
from magmatch.field.tiles.region_model import MOST_OPERATIONS
from magmatch.preparation.consistency import MapConsistency, affordable, held_out_error

H = Hyperparameters(0.8, 8e-6, 0.3e-6, 0.4)
RNG = np.random.default_rng(0)
X = box(RNG, 150)
WEIGHTS = RNG.uniform(0.3, 1.5, 150)
FIELD = some_field(2, slope=4e-6, bend=4e-6)


def map_of(values, weights):
    model = SplineModel.over(X, H)
    return model.infer(model.observe(X, values, weights))


def test_what_is_left_is_what_the_map_of_each_column_misses_and_the_left_side_is_weighted():
    columns = 1e-6 * RNG.standard_normal((2, 150, 3))
    left, right = MapConsistency(X, H, WEIGHTS).project(columns)
    np.testing.assert_allclose(left, columns * WEIGHTS[:, None], rtol=1e-12)
    for column, rest in zip(columns, right, strict=True):
        np.testing.assert_allclose(rest, column - map_of(column, WEIGHTS).evaluate(X).field, atol=1e-12)


def test_a_smooth_field_is_explained_and_its_gradient_is_the_slope():
    consistency = MapConsistency(X, H, np.ones(150))
    values = FIELD.evaluate(X, 1)
    assert np.abs(consistency.project(values.field[None])[1]).mean() < 0.05e-6
    inside = np.abs(X).max(axis=1) < 0.5
    missed = consistency.gradient(values.field) - values.gradient
    assert np.sqrt((missed[inside] ** 2).mean()) < 0.1 * np.sqrt((values.gradient**2).mean())


def test_the_miss_of_left_out_stretches_is_that_of_the_noise_where_the_field_is_smooth_and_grows_with_errors():
    t = np.linspace(0, 1, 600)
    path = np.stack([np.sin(40 * t), np.sin(46 * t + 1), 0.2 * np.sin(7 * t)], axis=1)
    noise = 0.3e-6 * np.random.default_rng(1).standard_normal(path.shape)
    smooth = some_field(2, slope=2e-6, bend=1e-6).evaluate(path).field
    wide = replace(H, lengthscale=1.5, spacing=0.6)
    clean = held_out_error(path, smooth + noise, wide)
    # The median size of a vector of three components.
    assert clean == pytest.approx(1.54 * 0.3e-6, rel=0.3)
    rough = 2e-6 * np.sign(np.sin(300 * t))[:, None] * np.ones(3)
    assert held_out_error(path, smooth + rough + noise, wide) > 4 * clean
    assert held_out_error(path, 0 * smooth + EARTH, wide) < 0.05e-6


def test_a_map_in_too_much_detail_is_coarsened_before_its_memory_is_taken(caplog):
    points = np.random.default_rng(0).uniform(0, 0.4, (4000, 3))
    fine = Hyperparameters(0.0098, 1e-6, 1e-6, 0.0037, 3.0)
    h = affordable(points, fine)
    assert SplineModel.over(points, h).elimination.n_operations <= MOST_OPERATIONS
    assert h.lengthscale >= 2.5 * h.spacing > 5 * fine.spacing
    assert "--thin METRES" in caplog.text
    ordinary = Hyperparameters(0.3, 1e-6, 1e-6, 0.15, 3.0)
    assert affordable(points, ordinary) == ordinary
