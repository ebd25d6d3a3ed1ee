# SPDX-License-Identifier: BSD-3-Clause
"""The mapping table asks every model for the same points and knows the truth there."""

from types import SimpleNamespace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from magmatch.data.survey import Survey
from magmatch.field.sensor_biases import SensorBiases
from magmatch.simulation.config import SimulationConfig
from magmatch_evaluation.baselines.interpolation import inverse_distance, local_gp, nearest_neighbour
from magmatch_evaluation.benchmark import evaluate
from magmatch_evaluation.experiments import Experiment
from magmatch_evaluation.held_out_field import PREDICTORS, HeldOut, SimulatedField, differences, read_beside
from magmatch_evaluation.plan import make_plan


def linear(p):
    return 1e-6 * (p @ np.array([[1.0, 2.0, 3.0], [0.5, -1.0, 0.0], [0.0, 4.0, 1.0]]).T) + 1e-5


def test_differences_give_the_gradient_of_a_linear_field():
    points = np.random.default_rng(0).standard_normal((5, 3))
    expected = 1e-6 * np.array([[1.0, 2.0, 3.0], [0.5, -1.0, 0.0], [0.0, 4.0, 1.0]])
    np.testing.assert_allclose(differences(linear, points), np.broadcast_to(expected, (5, 3, 3)), atol=1e-15)


@pytest.mark.parametrize("predict", [nearest_neighbour, inverse_distance, local_gp])
def test_peers_give_samples_back_and_constants_everywhere(predict):
    rng = np.random.default_rng(1)
    points = rng.uniform(0, 2, (80, 3))
    field = linear(points)
    # Kriging fits a noise of its own: nearly.
    np.testing.assert_allclose(predict(points, field, points), field, atol=2e-8)
    if predict is not local_gp:
        constant = np.full((80, 3), 3e-5)
        np.testing.assert_allclose(predict(points, constant, rng.uniform(0, 2, (9, 3))), 3e-5, atol=1e-12)


def test_peer_has_the_error_that_it_has():
    points = np.random.default_rng(2).uniform(0, 1, (50, 3))
    survey = Survey(points, linear(points))
    off = linear(points) + np.array([3e-6, 0.0, 4e-6])
    field_rmse, gradient_rmse, coverage = PREDICTORS["nearest"](HeldOut(survey, points, off, None, is_noisy=True))
    assert field_rmse == pytest.approx(5e-6)
    assert np.isnan(gradient_rmse)
    assert np.isnan(coverage)


def test_a_held_out_stretch_is_read_with_the_bias_of_its_sensor():
    rng = np.random.default_rng(3)
    points, turns, bias = rng.uniform(0, 1, (50, 3)), Rotation.random(50, rng), np.array([2e-6, -1e-6, 3e-6])
    rest = Survey(points, linear(points) + turns.apply(bias), orientations=turns)
    of_one = SimpleNamespace(biases=SensorBiases(bias[None], np.full((1, 3), 1e-7), 2e-6))
    np.testing.assert_allclose(read_beside(of_one, rest), turns.apply(bias), atol=1e-18)
    assert not read_beside(of_one, None).any()
    assert not read_beside(SimpleNamespace(biases=None), rest).any()


def test_mapping_rows_are_kept_and_not_made_twice(tmp_path):
    pytest.importorskip("magpylib", reason="surveys are simulated with the extra 'simulation'")
    make = SimulatedField("office-random", SimulationConfig(n_samples=450))
    plan = make_plan([Experiment("m", "", "mapping", make, 1, ("nearest", "idw"))], PREDICTORS)
    first, again = evaluate(plan, tmp_path), evaluate(plan, tmp_path)
    assert [repr(r) for r in first] == [repr(r) for r in again]
    assert len((tmp_path / "mapping.jsonl").read_text().splitlines()) == 2
    assert {r.method: r.field_rmse > 1e-7 for r in first} == {"nearest": True, "idw": True}
