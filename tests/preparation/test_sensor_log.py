# SPDX-License-Identifier: BSD-3-Clause
"""Readings and poses on two clocks: where a moved stamp falls, and how fast the poses change there."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from magmatch.data.survey import Survey
from magmatch.data.trajectory import Trajectory
from magmatch.preparation.sensor_log import SensorLog

RATE = 50.0
SPIN, VELOCITY = np.array([0.4, -0.3, 0.8]), np.array([0.5, 0.2, -0.1])
START = Rotation.from_rotvec([0.3, 0.2, -0.5])


def poses_at(t):
    """A steady motion: dR/dt = [spin]x R in the survey's frame."""
    return np.asarray(t)[:, None] * VELOCITY, Rotation.from_rotvec(np.asarray(t)[:, None] * SPIN) * START


@pytest.fixture
def log():
    t = np.arange(200) / RATE
    positions, orientations = poses_at(t)
    field = np.tile([2e-5, 0, -4e-5], (200, 1))
    return SensorLog.of(Survey(positions, field, t, orientations))


def test_moved_stamps_have_the_poses_of_their_time(log):
    rows = np.arange(20, 150)
    positions, orientations = log.subset(rows).at(0.03)
    expected, turned = poses_at(log.times[rows] + 0.03)
    np.testing.assert_allclose(positions, expected, atol=1e-12)
    assert (orientations.inv() * turned).magnitude().max() < 1e-9
    assert log.at(0.0)[0] is log.positions


def test_velocity_and_spin_are_the_derivatives_of_the_poses_in_the_surveys_axes(log):
    velocity, spin = log.subset(np.arange(5, 190)).motion(0.013)
    np.testing.assert_allclose(velocity, np.tile(VELOCITY, (185, 1)), atol=1e-9)
    np.testing.assert_allclose(spin, np.tile(SPIN, (185, 1)), atol=1e-9)
    # At the ends over what there is of the trajectory.
    np.testing.assert_allclose(log.motion(0.0)[0], np.tile(VELOCITY, (200, 1)), atol=1e-9)


def test_a_trajectory_of_its_own_is_used_and_one_pose_is_none(log):
    t = np.arange(0, 5, 0.5)
    own = Trajectory(t, *poses_at(t))
    survey = Survey(log.positions, log.readings, log.times, log.orientations)
    assert SensorLog.of(survey, own).trajectory is own
    one = SensorLog.of(survey.subset(np.arange(1)))
    assert one.times is None
    assert len(one) == 1
