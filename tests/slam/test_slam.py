# SPDX-License-Identifier: BSD-3-Clause
"""Slam from end to end: drift falls where places repeat, logs find each other, and strangers stay apart."""

from dataclasses import replace

import numpy as np
import pytest

import magmatch as mm
from drifting import EARTH, Place, about_z, drifting_walk, trajectory_error
from magmatch.data.survey import Survey
from magmatch.errors import SurveyError
from magmatch.preparation.odometry.drift import OdometryConfig
from magmatch.slam.config import SlamConfig
from magmatch.slam.run import slam
from magmatch.slam.windows import bend

WALK, _ = drifting_walk(Place(1), 1)


def test_a_walk_twice_round_is_corrected(lone):
    before = trajectory_error(lone.truth, lone.log.positions)
    after = trajectory_error(lone.truth, lone.session.trajectories[0].positions)
    assert after < 0.6 * before
    assert lone.session.graph.closures
    assert lone.session.graph.config.is_planar  # all poses lie at one height


def stood(n=200):
    rng = np.random.default_rng(0)
    return Survey(0.002 * rng.normal(size=(n, 3)), 3e-5 + 2e-7 * rng.normal(size=(n, 3)), times=np.arange(n) * 0.1)


UNCHANGED = {
    "a walk that passes nothing twice": drifting_walk(Place(1), 1, laps=0.8)[0],
    "a robot that stands": stood(),
    "a constant field, which tells no place from another": replace(WALK, field=np.tile(EARTH, (len(WALK), 1))),
    # The heading is known: where they point says nothing.
    "a field that is the same everywhere": replace(
        WALK, field=EARTH + 3e-7 * np.random.default_rng(0).standard_normal(WALK.field.shape)
    ),
}


@pytest.mark.parametrize("case", UNCHANGED)
def test_what_shows_no_place_twice_stays_as_it_came(case):
    log = UNCHANGED[case]
    session = slam(log)
    assert not session.graph.closures
    assert session.result().status == "unchanged"
    np.testing.assert_allclose(session.trajectories[0].positions, log.positions, atol=1e-6)
    # What is said of the end is what odometry says of the whole path.
    if case.startswith("a walk"):
        assert len(session.paths[0].windows) > 2
        loads = bend(log.positions[::4], 0, session.config.odometry, upright=True, planar=True)[-1]
        place = np.sqrt(np.trace(loads[3:] @ loads[3:].T))
        assert session.result().logs[0].sd[0] == pytest.approx(place, rel=0.1)


def test_odometry_that_jumps_is_no_fault_of_the_program():
    log, truth = drifting_walk(Place(1), 1, laps=1.5)
    jump = np.where(np.arange(len(log)) > 300, 100.0, 0.0)[:, None] * [1.0, 0.0, 0.0]
    jumped = replace(log, positions=log.positions + jump)
    session = slam(jumped)
    after = session.trajectories[0].positions
    assert np.isfinite(after).all()
    assert trajectory_error(truth, after) < 1.1 * trajectory_error(truth, jumped.positions)
    assert session.result().logs[0].sd[0] > 0.5  # nobody knows how far it jumped


def test_a_turn_that_odometry_missed_is_found_though_the_rest_drifts_little():
    # Of seeds 1 to 6 three were left 0.5 to 1.2 m off when drift was learned from what was closed first.
    seed = 5
    one, p_one = drifting_walk(Place(seed), 10 + seed, turn=0.5, scale=0.003, name="one.csv")
    other, p_other = drifting_walk(Place(seed), 20 + seed, turn=0.5, scale=0.003, name="other.csv")
    missed = about_z(np.where(np.arange(len(other)) < 140, np.radians(40), 0.0))
    at = other.positions[140]
    turned = replace(
        other,
        positions=at + missed.apply(other.positions - at),
        field=missed.apply(other.field),
        orientations=missed * other.orientations,
    )
    session = slam([one, turned])
    assert session.components == [[0, 1]]
    after = np.concatenate([t.positions for t in session.trajectories])
    assert trajectory_error(np.concatenate([p_one, p_other]), after) < 0.2


def test_a_gap_in_a_log_is_walked_over():
    log, truth = drifting_walk(Place(1), 1)
    rows = np.flatnonzero((np.arange(len(log)) < 100) | (np.arange(len(log)) > 160))
    session = slam(log.subset(rows))
    after = session.trajectories[0].positions
    assert trajectory_error(truth[rows], after) < 0.8 * trajectory_error(truth[rows], log.positions[rows])


def test_a_log_of_one_window_does_not_know_its_end():
    log, _ = drifting_walk(Place(1), 1, laps=0.5)
    session = slam(log, SlamConfig(window_length=100.0))
    assert len(session.graph.p) == 1
    (stated,) = session.result().logs
    assert stated.sd[0] > 0.1
    assert stated.sd[1] > 0.01


def test_neither_times_nor_orientations_are_needed(tmp_path):
    log, truth = drifting_walk(Place(1), 1)
    session = slam(replace(log, times=None, orientations=None))
    after = session.trajectories[0]
    assert after.times is None
    assert after.orientations is None
    result = mm.write_folder(session, tmp_path / "out")
    assert {p.suffix for p in (tmp_path / "out").iterdir()} == {".csv", ".map", ".g2o", ".json", ".state"}
    assert all(c.t_a is None for c in result.closures)
    assert trajectory_error(truth, after.positions) < 0.8 * trajectory_error(truth, log.positions)


@pytest.mark.parametrize(
    ("logs", "error", "words"),
    [
        ([], ValueError, "at least one log"),
        ("walk.csv", TypeError, "Survey"),
        (3.0, TypeError, "logs: expected Survey"),
        ([Survey(np.zeros((3, 3)), np.full((3, 3), 3e-5))], SurveyError, "at least 10 samples"),
        ([Survey(np.zeros((20, 3)), np.full((20, 3), 3e-5))], SurveyError, "one point"),
        ([WALK, WALK], SurveyError, "holds the same samples as walk"),
        ([replace(WALK, positions=1000 * WALK.positions)], SurveyError, "wrong length unit"),
    ],
)
def test_what_is_no_log_is_refused_in_one_sentence(logs, error, words):
    with pytest.raises(error, match=words):
        slam(logs)


def test_settings_are_those_of_slam():
    with pytest.raises(TypeError, match="SlamConfig"):
        slam(drifting_walk(Place(1), 1)[0], {"is_planar": True})
    with pytest.raises(ValueError, match="window_length"):
        SlamConfig(window_length=-1)


def test_the_verb_is_called_by_the_rooms_name_however_often():
    log, _ = drifting_walk(Place(1), 1)
    constant = replace(log, field=np.tile([2e-5, 0.0, -4.5e-5], (len(log), 1)))
    for _ in range(2):
        assert mm.slam(constant).result().status == "unchanged"


def test_odometry_that_drifts_more_than_stated_is_corrected_though_little_is_passed_twice():
    """By 6 degrees in a metre where 1 is stated: what it passes twice lies where nothing expects it."""
    log, truth = drifting_walk(Place(2), 3, laps=1.35, turn=6.0)
    stated = SlamConfig(odometry=OdometryConfig(sd=(0.15, 3.0)))
    session = mm.slam(log, stated)
    assert trajectory_error(truth, session.trajectories[0].positions) < 0.3 * trajectory_error(truth, log.positions)
    np.testing.assert_allclose(session.graph.config.odometry.sd, np.e * np.array(stated.odometry.sd))
