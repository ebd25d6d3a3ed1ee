# SPDX-License-Identifier: BSD-3-Clause
"""A magnetometer's difference from another: undone, differentiated, and held by its prior."""

import numpy as np
import pytest

from magmatch.registration.refine.sensors import (
    TIED_SD,
    SensorConfig,
    SensorModel,
    identical_sensors,
    is_soft_iron,
    levels_to_try,
    prior_sd,
)

RNG = np.random.default_rng(0)
FIELD = 4e-5 * RNG.standard_normal((20, 3))
MODES = {"none": (-1, 3), "bias": (1, 3), "scale": (1, 4), "full": (1, 12), "auto": (2, 12)}


def some_sensor(mode="full", size=0.02):
    start = identical_sensors(SensorConfig(mode=mode), MODES[mode][0])
    step = np.append(1e-6 * RNG.standard_normal(3), size * RNG.standard_normal(start.n_parameters - 3))
    return start.stepped(step), step


@pytest.mark.parametrize("mode", ["bias", "scale", "full"])
def test_parameters_are_those_that_it_was_stepped_by(mode):
    sensor, step = some_sensor(mode)
    np.testing.assert_allclose(sensor.parameters, step, atol=1e-15)
    np.testing.assert_allclose(sensor.stepped(-step).gain, np.eye(3), atol=1e-15)
    assert sensor.n_parameters == len(step) == MODES[mode][1]


def test_correcting_undoes_gain_and_bias():
    sensor, _ = some_sensor()
    np.testing.assert_allclose(sensor.correct(FIELD @ sensor.gain.T + sensor.bias), FIELD, atol=1e-18)


def test_residuals_half_way_are_shown_by_half_of_the_difference():
    sensor, _ = some_sensor()
    half = np.eye(3) + (sensor.gain - np.eye(3)) / 2
    np.testing.assert_allclose(sensor.half_way(FIELD), FIELD @ half.T, atol=1e-18)


@pytest.mark.parametrize("mode", ["bias", "scale", "full"])
def test_the_jacobian_is_that_of_residuals_half_way_to_first_order_in_the_gain(mode):
    sensor = identical_sensors(SensorConfig(mode=mode), 1)
    expected = FIELD + 1e-6 * RNG.standard_normal(FIELD.shape)

    def residual(step):
        moved = sensor.stepped(step)
        return moved.half_way(moved.correct(FIELD) - expected)

    found = sensor.jacobian((FIELD + expected) / 2)
    for k in range(sensor.n_parameters):
        step = np.zeros(sensor.n_parameters)
        step[k] = 1e-9 if k < 3 else 1e-6
        numeric = (residual(step) - residual(-step)) / (2 * step[k])
        np.testing.assert_allclose(found[:, :, k], numeric, atol=1e-5 * max(np.abs(numeric).max(), 1e-9))


def test_no_parameter_is_stepped_beyond_its_limit():
    sensor = identical_sensors(SensorConfig(mode="scale"), 1).stepped(
        np.array([5e-6, -5e-6, 1e-6, 0.5]), np.full(4, 2e-6)
    )
    np.testing.assert_allclose(sensor.parameters, [2e-6, -2e-6, 1e-6, 2e-6], atol=1e-15)


def test_each_mode_frees_its_own_parameters_at_the_levels_that_it_tries():
    for mode, (last, n) in MODES.items():
        config = SensorConfig(mode=mode)
        levels = levels_to_try(config)
        assert levels[-1] == last
        assert levels == (tuple(range(3)) if mode == "auto" else (last,))
        assert identical_sensors(config, last).n_parameters == n
        assert is_soft_iron(config, last) == (n == 12)
    assert identical_sensors(SensorConfig(), 1).n_parameters == 4


def test_a_prior_is_that_of_its_level_and_beyond_the_widest_stays_there():
    config = SensorConfig(bias_levels=(1e-6, 2e-6))
    np.testing.assert_allclose(prior_sd(config, 0, 4), [1e-6] * 3 + [0.01])
    np.testing.assert_allclose(prior_sd(config, 2, 12), [2e-6] * 3 + [0.02] * 9)
    np.testing.assert_allclose(prior_sd(config, -1, 4), TIED_SD)


def test_soft_iron_may_be_any_gain():
    gain = np.eye(3) + 0.1 * RNG.standard_normal((3, 3))
    model = SensorModel(np.zeros(3), gain, np.eye(9).reshape(9, 3, 3))
    np.testing.assert_allclose(identical_sensors(SensorConfig(), 2).stepped(model.parameters).gain, gain)
