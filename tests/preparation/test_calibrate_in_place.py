# SPDX-License-Identifier: BSD-3-Clause
"""A sensor turned about in one place tells its hard and soft iron; what it was not turned to see stays open."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from magmatch.errors import SurveyError
from magmatch.preparation.calibrate_in_place import fit_ellipsoid
from magmatch.simulation.corruption import Corruption, draw_corruption

HARD_IRON = np.array([5e-6, -8e-6, 12e-6])
EARTH = np.array([17.8e-6, 0, -44.6e-6])


def turned(orientations, corruption, rng, noise=0.3e-6):
    readings = orientations.apply(EARTH, inverse=True) @ corruption.soft_iron.T + corruption.hard_iron
    return readings + noise * rng.standard_normal(readings.shape)


# One huge spike, some, and many.
@pytest.mark.parametrize(("n_spikes", "size"), [(1, 0.1), (5, 30e-6), (100, 1e-3)])
@pytest.mark.parametrize("seed", range(5))
def test_hard_and_soft_iron_are_found_in_spite_of_spikes(seed, n_spikes, size):
    rng = np.random.default_rng(seed)
    corruption = draw_corruption(rng, hard_iron=60e-6, soft_iron=0.1)
    readings = turned(Rotation.random(500, rng=rng), corruption, rng)
    readings[:n_spikes] += size * rng.standard_normal((n_spikes, 3))
    model, solution = fit_ellipsoid(readings)
    np.testing.assert_allclose(model.hard_iron, corruption.hard_iron, rtol=0, atol=0.15e-6)
    truth = corruption.soft_iron / np.cbrt(np.linalg.det(corruption.soft_iron))
    np.testing.assert_allclose(model.soft_iron, truth, rtol=0, atol=5e-3)
    assert not any(np.any(is_open) for is_open in solution.is_open.values())


# Of many readings, noise alone spreads the normal of a ring; a sensor's z axis is often the noisiest.
@pytest.mark.parametrize("noise", [0.1e-6, 0.3e-6, 1e-6, [0.3e-6, 0.3e-6, 0.6e-6]], ids=str)
@pytest.mark.parametrize("seed", range(3))
def test_noise_does_not_tell_the_axis_that_a_sensor_was_turned_about(seed, noise):
    rng = np.random.default_rng(seed)
    about_z = Rotation.from_euler("z", rng.uniform(0, 2 * np.pi, (1500, 1)))
    model, solution = fit_ellipsoid(turned(about_z, Corruption(hard_iron=HARD_IRON), rng, np.array(noise)))
    assert solution.is_open["hard_iron"].tolist() == [False, False, True]
    np.testing.assert_allclose(model.hard_iron, [*HARD_IRON[:2], 0], rtol=0, atol=0.3e-6)


@pytest.mark.parametrize("axis", [0, 2])
def test_neither_does_rounding(axis):
    angles = np.linspace(0, 6, 300)[:, None]
    readings = Rotation.from_euler("xyz"[axis], angles).apply(EARTH) + HARD_IRON
    model, solution = fit_ellipsoid(readings)
    assert np.flatnonzero(solution.is_open["hard_iron"]).tolist() == [axis]
    np.testing.assert_allclose(model.hard_iron, np.where(np.arange(3) == axis, 0, HARD_IRON), rtol=0, atol=0.1e-6)


@pytest.mark.parametrize("tilt", [15, 20, 40])
@pytest.mark.parametrize("seed", range(3))
def test_tilts_of_some_degrees_tell_it(seed, tilt):
    rng = np.random.default_rng(seed)
    angles = rng.uniform([-180, -tilt, -tilt], [180, tilt, tilt], (1500, 3))
    readings = turned(Rotation.from_euler("zyx", angles, degrees=True), Corruption(hard_iron=HARD_IRON), rng)
    np.testing.assert_allclose(fit_ellipsoid(readings)[0].hard_iron, HARD_IRON, rtol=0, atol=1e-6)


def test_a_field_that_is_not_one_is_refused():
    rng = np.random.default_rng(3)
    with pytest.raises(SurveyError, match="no ellipsoid fits"):
        fit_ellipsoid(rng.uniform(0.1, 3.0, (300, 1)) * Rotation.random(300, rng=rng).apply(EARTH))


def test_too_few_readings_are_refused():
    with pytest.raises(SurveyError, match="at least 50 different readings"):
        fit_ellipsoid(np.ones((10, 3)))
