# SPDX-License-Identifier: BSD-3-Clause
"""What odometry states of its drift is found in its covariances, and what cannot be one is not believed."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from magmatch.data.logs.drift import drift, read_drift


def path(seed=0, n=400, step=0.1):
    rng = np.random.default_rng(seed)
    heading = np.cumsum(0.1 * rng.normal(size=n))
    return step * np.cumsum(np.column_stack([np.cos(heading), np.sin(heading), 0 * heading]), axis=0)


def covariances(x, place, turn, start=0.0):
    """As a filter carries them along: m and degrees in 10 m."""
    p, q = place**2 / 10, np.radians(turn) ** 2 / 10
    P, found = start * np.eye(3), []
    for k in range(len(x)):
        if k:
            dx, dy = x[k, :2] - x[k - 1, :2]
            F = np.array([[1, 0, -dy], [0, 1, dx], [0, 0, 1]])
            P = F @ P @ F.T + np.hypot(dx, dy) * np.diag([p, p, q])
        C = 1e6 * np.eye(6)  # what a robot on a floor does not know of height and tilt
        C[np.ix_([0, 1, 5], [0, 1, 5])] = P
        found.append(C)
    return np.array(found)


@given(st.floats(0.01, 0.5), st.floats(0.1, 10.0), st.floats(0, 0.01), st.integers(0, 5))
@settings(max_examples=25, deadline=None)
def test_the_drift_behind_a_covariance_is_found(place, turn, start, seed):
    x = path(seed)
    np.testing.assert_allclose(drift(x, covariances(x, place, turn, start)), (place, turn), rtol=1e-6)


@pytest.mark.parametrize(
    "wrong",
    [
        lambda C: 0 * C,
        lambda C: 0 * C + 1e9 * np.eye(6),
        lambda C: 0 * C + 1e-3 * np.eye(6),  # the same all along
        np.ones_like,
        lambda C: -C,
        lambda C: np.where(np.arange(len(C))[:, None, None] == 7, np.nan, C),
        lambda C: C[::-1],
        lambda C: 1e6 * C,
        lambda C: C[:2],
    ],
)
def test_what_cannot_be_a_covariance_of_a_path_is_not_believed(wrong):
    x = path()
    C = wrong(covariances(x, 0.2, 2.0))
    assert drift(x[: len(C)], C) is None


@pytest.mark.parametrize("scale", [0.0, 1e300])
def test_a_robot_that_stands_or_is_nowhere_on_earth_states_nothing(scale):
    x = path()
    assert drift(scale * x, covariances(x, 0.2, 2.0)) is None


@pytest.mark.parametrize("container", ["ros1", "mcap"])
def test_it_is_read_from_odometry_and_nothing_else(container, made, tmp_path, monkeypatch):
    flight = made.flight()
    C = covariances(flight.poses[:, :3], 0.2, 2.0)
    build = made.Messages.build

    def with_covariance(self, series, i):
        message = build(self, series, i)
        if series.type.endswith("Odometry"):
            message.pose.covariance[:] = C[i].ravel()
        return message

    monkeypatch.setattr(made.Messages, "build", with_covariance)
    path = tmp_path / f"a.{'bag' if container == 'ros1' else 'mcap'}"
    np.testing.assert_allclose(read_drift(getattr(made, container)(path, flight.series)), (0.2, 2.0), rtol=1e-3)


def test_logs_without_it_state_nothing(made, tmp_path):
    flight = made.flight()
    # Each covariance is a matrix of ones.
    assert read_drift(made.mcap(tmp_path / "ones.mcap", flight.series)) is None
    kind = "geometry_msgs/msg/PoseStamped"
    poses = [made.replace(s, type=kind) if s.type.endswith("Odometry") else s for s in flight.series]
    assert read_drift(made.mcap(tmp_path / "poses.mcap", poses)) is None
    (tmp_path / "walk.csv").write_text("x,y,z,bx,by,bz\n0,0,0,1e-5,0,0\n")
    assert read_drift(tmp_path / "walk.csv") is None


def test_three_poses_tell_a_drift_and_two_do_not():
    x = path(n=3, step=5.0)
    np.testing.assert_allclose(drift(x, covariances(x, 0.2, 2.0, 1e-3)), (0.2, 2.0), rtol=1e-6)
    assert drift(x[:2], covariances(x[:2], 0.2, 2.0, 1e-3)) is None
