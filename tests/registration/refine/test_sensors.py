# SPDX-License-Identifier: BSD-3-Clause
"""A magnetometer's difference from another: undone, differentiated, and held by its prior."""

import numpy as np
import pytest

from magmatch.registration.refine.sensors import identical_sensors, levels_to_try

RNG = np.random.default_rng(0)
FIELD = 4e-5 * RNG.standard_normal((20, 3))
MODES = {"none": (-1, 3), "bias": (1, 3), "scale": (1, 4), "full": (1, 12), "auto": (2, 12)}


def some_sensor(mode="full", size=0.02):
    start = identical_sensors(mode, MODES[mode][0])
    step = np.append(1e-6 * RNG.standard_normal(3), size * RNG.standard_normal(start.n_parameters - 3))
    return start.stepped(step), step


def test_correcting_undoes_gain_and_bias():
    sensor, _ = some_sensor()
    np.testing.assert_allclose(sensor.correct(FIELD @ sensor.gain.T + sensor.bias), FIELD, atol=1e-18)


@pytest.mark.parametrize("mode", ["bias", "scale", "full"])
def test_the_jacobian_is_that_of_residuals_half_way_to_first_order_in_the_gain(mode):
    sensor = identical_sensors(mode, 1)
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
    sensor = identical_sensors("scale", 1).stepped(np.array([5e-6, -5e-6, 1e-6, 0.5]), np.full(4, 2e-6))
    np.testing.assert_allclose(sensor.parameters, [2e-6, -2e-6, 1e-6, 2e-6], atol=1e-15)


def test_each_mode_frees_its_own_parameters_at_the_levels_that_it_tries():
    for mode, (last, n) in MODES.items():
        levels = levels_to_try(mode)
        assert levels[-1] == last
        assert levels == (tuple(range(3)) if mode == "auto" else (last,))
        assert identical_sensors(mode, last).n_parameters == n
    assert identical_sensors("auto", 1).n_parameters == 4
