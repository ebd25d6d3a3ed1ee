# SPDX-License-Identifier: BSD-3-Clause
"""A magnetometer's difference from another: its parameters, and how far they go."""

import numpy as np

from magmatch.registration.refine.sensors import identical_sensors, levels_to_try

MODES = {"none": (-1, 3), "bias": (1, 3), "scale": (1, 4), "full": (1, 12), "auto": (2, 12)}


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
