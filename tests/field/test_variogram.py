# SPDX-License-Identifier: BSD-3-Clause
"""The length over which a field changes."""

import numpy as np
import pytest

from magmatch.field.variogram import typical_length

CLOUD = np.random.default_rng(0).uniform(0, 3, (2000, 3))


@pytest.mark.parametrize("length", [0.3, 0.6, 1.0])
def test_typical_length_of_a_squared_exponential_potential_is_its_lengthscale(length):
    draw = np.random.default_rng(1)
    k = draw.normal(size=(400, 3)) / length
    phase = draw.uniform(0, 2 * np.pi, 400)
    field = 1e-6 * np.sin(CLOUD @ k.T + phase) @ k
    assert typical_length(CLOUD, field) == pytest.approx(length, rel=0.35)


def test_a_few_spikes_do_not_change_the_typical_length():
    field = 1e-6 * np.sin(3 * CLOUD)
    spiked = field.copy()
    spiked[::100] += 1e-4
    assert typical_length(CLOUD, spiked) == pytest.approx(typical_length(CLOUD, field), rel=0.3)


def test_the_typical_length_of_many_samples_is_that_of_few():
    points = np.random.default_rng(3).uniform(0, 3, (24_000, 3))
    few = typical_length(points[::8], 1e-6 * np.sin(3 * points[::8]))
    assert typical_length(points, 1e-6 * np.sin(3 * points)) == pytest.approx(few, rel=0.15)
