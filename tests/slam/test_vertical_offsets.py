# SPDX-License-Identifier: BSD-3-Clause
"""Level logs whose sensors differ by a constant along the vertical."""

import re
from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

import magmatch as mm
from drifting import Place, drifting_walk, trajectory_error
from magmatch.slam.loop_closer import LoopCloser
from magmatch.slam.vertical_offsets import with_vertical_offsets

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


def test_a_log_that_is_added_later_is_connected_too_and_its_sensor_named(session, caplog):
    later = mm.slam(ONE)
    later.add_log(other()[0])
    assert re.search(r"other.csv: its sensor differs by 1[45](\.\d)? uT along the vertical", caplog.text)
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


class HandMadePlaces:
    """Three logs, of which the first and the last share a frame."""

    def __init__(self, frames=(0, 1, 0), shifted=()):
        self.shifted, self.graph = list(shifted), SimpleNamespace(frames=lambda: np.array(frames))
        self.paths = [SimpleNamespace(survey=replace(ONE, name=f"{k}.csv"), number=k) for k in range(3)]
        self.stated = mm.SlamConfig()
        self.frames = frames

    def others(self, path):
        return [p for p in self.paths[: path.number] if self.frames[p.number] != self.frames[path.number]]

    def without_vertical(self, logs, offset):
        return HandMadePlaces(self.frames, [*self.shifted, *logs])


@pytest.mark.parametrize(
    ("joined_by", "shifted"), [((), []), ([1], [1]), ([0, 2], [0, 2])], ids=["nothing", "its shift", "the others'"]
)
def test_logs_of_one_frame_are_shifted_together_and_only_what_that_connects_stays_so(joined_by, shifted):
    def look(again, paths):
        if [path.number for path in paths] == joined_by:
            again.places = HandMadePlaces((0, 0, 0), again.places.shifted)

    found = with_vertical_offsets(LoopCloser(HandMadePlaces(), None), look)
    assert found.places.shifted == shifted


def test_where_up_is_not_known_nothing_is_made_equal():
    session = mm.slam([ONE, other()[0]], mm.SlamConfig(is_gravity_aligned=False))
    assert sorted(session.components) == [[0], [1]]
