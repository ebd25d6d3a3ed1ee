# SPDX-License-Identifier: BSD-3-Clause
"""Level logs whose sensors differ by a constant along the vertical."""

from dataclasses import replace

import numpy as np
import pytest

import magmatch as mm
from drifting import Place, drifting_walk, trajectory_error

OFFSET = 15e-6
ONE, TRUTH = drifting_walk(Place(1), 11, laps=1.2, name="one.csv")


def other(place: int = 1, laps: float = 0.8) -> tuple[mm.Survey, np.ndarray]:
    """Walk with another sensor, which is offset along the vertical."""
    return drifting_walk(Place(place), 21, laps=laps, start=2.0, name="other.csv", bias=(0.0, 0.0, OFFSET))


@pytest.fixture(scope="module")
def session():
    return mm.slam([ONE, other()[0]])


def error_of(session):
    after = np.concatenate([path.positions for path in session.trajectories])
    return trajectory_error(np.concatenate([TRUTH, other()[1]]), after)


def stated_biases(session):
    return [log["bias"] for log in session.result().odometry["logs"].values()]


def test_logs_of_one_place_are_connected_and_the_offset_is_stated(session):
    assert session.components == [[0, 1]]
    assert error_of(session) < 0.5 * trajectory_error(TRUTH, ONE.positions)
    first, second = stated_biases(session)
    assert second[2] - first[2] == pytest.approx(OFFSET, abs=1e-6)
    one, two = session.trajectories
    assert np.median(two.field[:, 2]) == pytest.approx(np.median(one.field[:, 2]), abs=1e-7)


def test_a_log_that_is_added_later_is_connected_too(session):
    later = mm.slam(ONE)
    later.add_log(other()[0])
    assert later.components == [[0, 1]]
    assert error_of(later) < 1.2 * error_of(session)


@pytest.mark.slow
def test_logs_without_orientations_are_connected_in_their_own_axes():
    session = mm.slam([replace(log, orientations=None) for log in (ONE, other()[0])])
    assert session.components == [[0, 1]]
    first, second = stated_biases(session)
    np.testing.assert_allclose(np.subtract(second, first), [0, 0, OFFSET], atol=1e-6)


def test_a_log_of_another_place_stays_as_it_came():
    stranger, _ = other(place=9)
    session = mm.slam([ONE, stranger])
    assert sorted(session.components) == [[0], [1]]
    np.testing.assert_allclose(session.trajectories[1].field[:, 2], stranger.field[:, 2], atol=1e-12)
    assert stated_biases(session)[1][2] == pytest.approx(0, abs=1e-7)


def test_where_up_is_not_known_nothing_is_made_equal():
    session = mm.slam([ONE, other()[0]], mm.SlamConfig(is_gravity_aligned=False))
    assert sorted(session.components) == [[0], [1]]
