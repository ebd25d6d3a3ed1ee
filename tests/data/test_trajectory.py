# SPDX-License-Identifier: BSD-3-Clause
"""Trajectories: interpolation follows the motion it should, and never goes beyond the poses."""

import logging
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from magmatch.data.formats.recording import Recording
from magmatch.data.trajectory import Trajectory


def helix(n=20, rate=0.3):
    times = np.linspace(0.0, 10.0, n)
    return Trajectory(
        times, np.outer(times, [1.0, -2.0, 0.5]), Rotation.from_rotvec(np.outer(rate * times, [0, 0.6, 0.8]))
    )


@settings(deadline=None, max_examples=25)
@given(times=st.lists(st.floats(0, 10), min_size=1, max_size=20), rate=st.floats(-1, 1))
def test_steady_motion_is_interpolated_exactly(times, rate):
    times = np.array(times)
    positions, orientations = helix(rate=rate).interpolate(times)
    np.testing.assert_allclose(positions, np.outer(times, [1.0, -2.0, 0.5]), atol=1e-12)
    expected = Rotation.from_rotvec(np.outer(rate * times, [0, 0.6, 0.8]))
    assert orientations.approx_equal(expected, atol=1e-7).all()  # the angle of a tiny rotation costs half the digits


def test_interpolation_takes_the_shortest_turn_whatever_the_sign_of_the_quaternion():
    quaternions = Rotation.from_rotvec([[0.0, 0.0, 0.0], [0.0, 0.0, 0.4]]).as_quat() * np.array([[1.0], [-1.0]])
    trajectory = Trajectory(np.array([0.0, 1.0]), np.zeros((2, 3)), Rotation.from_quat(quaternions))
    _, orientations = trajectory.interpolate(np.array([0.5]))
    np.testing.assert_allclose(orientations.magnitude(), 0.2, atol=1e-12)


@pytest.mark.parametrize("time", [-0.1, 10.1])
def test_poses_are_never_extrapolated(time):
    with pytest.raises(ValueError, match=r"1 of 2 times lie outside the trajectory's 0 to 10 s"):
        helix().interpolate(np.array([5.0, time]))


def test_saving_and_loading_keeps_the_poses(tmp_path):
    trajectory = helix()
    trajectory.save(tmp_path / "poses.tum")
    loaded = Trajectory.load(tmp_path / "poses.tum")
    np.testing.assert_array_equal(loaded.times, trajectory.times)
    np.testing.assert_array_equal(loaded.positions, trajectory.positions)
    assert loaded.orientations.approx_equal(trajectory.orientations, atol=1e-12).all()


@pytest.mark.parametrize(
    ("times", "n_turns", "words"),
    [
        ([0.0], 1, "at least two poses"),
        ([0.0, 0.0], 2, "strictly increasing"),
        ([0.0, 1.0], 3, "each of 2 .*, got 3"),
    ],
)
def test_impossible_trajectory_is_refused(times, n_turns, words):
    with pytest.raises(ValueError, match=words):
        Trajectory(np.array(times), np.zeros((len(times), 3)), Rotation.identity(n_turns))


@pytest.mark.parametrize(("late", "level"), [(0.009, logging.INFO), (0.021, logging.WARNING)])
@pytest.mark.parametrize("side", [1, -1])
def test_samples_an_interval_beyond_the_poses_are_no_news(side, late, level, caplog):
    """Fields every 10 ms and poses every 20 ms, which end up to 20 ms apart where both stop at once."""
    caplog.set_level(logging.INFO)
    times = 1.0 + 0.01 * np.arange(100) + side * late
    poses = Trajectory(1.0 + np.linspace(0, 0.99, 50), np.zeros((50, 3)), Rotation.identity(50))
    recording = Recording(Path("log"), times, np.ones((100, 3)), poses)
    assert len(recording.survey()) < 100
    (record,) = (r for r in caplog.records if "without a pose" in r.message)
    assert record.levelno == level
