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


def test_the_typical_length_is_where_the_variogram_reaches_three_fifths():
    """Along a line through a field that turns at an even rate: half its squared change is 1 - cos, its sill 1."""
    x = np.linspace(0, 100, 6000)
    field = 1e-6 * np.c_[np.cos(x), np.sin(x), 0 * x]
    found = typical_length(np.c_[x, 0 * x, 0 * x], field)
    # The first of its bins, which double in distance every second one.
    assert 1 < found / np.arccos(0.4) < 1.45
