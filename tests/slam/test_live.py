# SPDX-License-Identifier: BSD-3-Clause
"""Samples as they come: poses are corrected on the way, and the end is what the whole log gives."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.transform import RigidTransform

import magmatch as mm
from drifting import Place, about_z, drifting_walk, loop, trajectory_error
from magmatch.registration.config import PRESETS


def feed(session, log, rows=None):
    """Samples of a log one by one; the pose after each."""
    places = []
    for k in range(len(log)) if rows is None else rows:
        T = RigidTransform.from_components(log.positions[k], log.orientations[k])
        session.add(float(log.times[k]), T, log.orientations[k].inv().apply(log.field[k]))
        places.append(session.pose())
    return places


@pytest.fixture(scope="module")
def walked():
    """A log twice round, live and then finished, and what was known on the way."""
    log, truth = drifting_walk(Place(1), 1)
    session = mm.Session()
    poses = feed(session, log)
    on_the_way = session.result()
    so_far = session.trajectories[0]
    session.finish("walk.csv")
    return log, truth, poses, on_the_way, so_far, session


def test_poses_are_corrected_as_closures_come(walked):
    log, truth, poses, on_the_way, so_far, _ = walked
    assert on_the_way.status == "connected"
    assert on_the_way.logs[0].name == "live"
    n = len(so_far)
    assert trajectory_error(truth[:n], so_far.positions) < 0.5 * trajectory_error(truth[:n], log.positions[:n])
    # The last pose was known when its sample came: nearer to the truth, seen from the start, than odometry is.
    assert np.isfinite([p.as_matrix() for p in poses]).all()
    last = poses[-1].translation
    start = poses[0].translation
    far = abs(np.linalg.norm(last - start) - np.linalg.norm(truth[-1] - truth[0]))
    before = abs(np.linalg.norm(log.positions[-1] - log.positions[0]) - np.linalg.norm(truth[-1] - truth[0]))
    assert far < 0.5 * before


@pytest.mark.slow
def test_samples_that_lie_close_do_not_make_the_field_look_short():
    # 2 cm apart: a first metre is one slope, of which a length of two samples was learned, and nothing closed.
    angle = np.linspace(0, 4.4 * np.pi, 2300)
    path, heading = loop(angle)
    rng, R = np.random.default_rng(0), about_z(heading)
    field = Place(1).field(path) + 2e-7 * rng.standard_normal(path.shape)
    log = mm.Survey(path, field, times=0.02 * np.arange(len(path)), orientations=R, name="walk.csv")
    session = mm.Session()
    feed(session, log)
    live = session.result()
    length = session.paths[0].windows[0].length
    session.finish("walk.csv")
    assert live.status == "connected"
    assert 0.7 < length / session.paths[0].windows[0].length < 1.4


@pytest.mark.slow
def test_noise_is_not_taken_for_a_field_that_changes_fast():
    # 1 cm apart, 1 uT of noise: of 3 m a length of 4 cm was learned, and kept.
    angle = 0.01 * np.arange(4600) / 3.3
    path, heading = loop(angle)
    rng, R = np.random.default_rng(0), about_z(heading)
    field = Place(1).field(path) + 1e-6 * rng.standard_normal(path.shape)
    session = mm.Session()
    feed(session, mm.Survey(path, field, times=0.01 * np.arange(len(path)), orientations=R, name="walk.csv"))
    assert session.paths[0].windows[0].length > 0.4
    assert session.result().status == "connected"


def test_calibrations_that_are_found_late_do_not_move_what_was_walked():
    # The sensor gets faster on the way: which jumps stand out changes, as they are found anew.
    log, _ = drifting_walk(Place(1), 1, laps=3)
    times = np.cumsum(np.where(np.arange(len(log)) < 350, 0.1, 0.02))
    rows = np.arange(len(log))[:, None]
    steps = sum(np.where(rows < row, 0.0, step) for row, step in [(60, 9e-6), (120, -15e-6), (500, 8e-6)])
    session = mm.Session()
    feed(session, replace(log, times=times, field=log.field + log.orientations.apply(steps * np.ones(3))))
    assert session.result().odometry["logs"]["live"]["recalibrations"]


def test_a_log_of_constant_field_is_followed_by_no_live_one():
    n = 300
    flat = mm.Survey(np.column_stack([0.05 * np.arange(n), np.zeros((n, 2))]), np.full((n, 3), 3e-5), name="flat.csv")
    session = mm.slam(flat)
    with pytest.raises(ValueError, match="constant"):
        session.add(0.0, RigidTransform.identity(), [3e-5, 0, 0])


@pytest.mark.slow
def test_a_phone_that_recalibrates_itself_on_the_way_still_finds_what_it_passes_again():
    log, truth = drifting_walk(Place(1), 1, laps=2.6)
    steps = np.where(np.arange(len(log))[:, None] < 400, 0.0, [8e-6, -4e-6, 4e-6])
    session = mm.Session()
    feed(session, replace(log, field=log.field + log.orientations.apply(steps)))
    walked = session.trajectories[0].positions
    n = len(walked)
    assert n > 450
    assert trajectory_error(truth[:n], walked) < 0.5 * trajectory_error(truth[:n], log.positions[:n])


def test_finished_it_is_what_slam_makes_of_the_log_bit_for_bit(walked):
    session = walked[-1]
    batch = mm.slam(session.given[0])
    np.testing.assert_array_equal(session.graph.p, batch.graph.p)
    np.testing.assert_array_equal(session.trajectories[0].field, batch.trajectories[0].field)
    assert [c.log_odds for c in session.graph.closures] == [c.log_odds for c in batch.graph.closures]


def test_a_log_that_is_walked_after_others_finds_them(lone):
    other, truth = drifting_walk(Place(1), 2, laps=1.2, start=2.0, name="b.csv")
    before = lone.session.graph.p.copy()
    session, again = replace(lone.session), replace(lone.session)
    poses = feed(session, other)
    assert session.components == [[0, 1]]
    late = slice(3 * len(truth) // 4, None)  # once it was found
    found = np.concatenate([session.trajectories[0].positions, [p.translation for p in poses[late]]])
    assert trajectory_error(np.concatenate([lone.truth, truth[late]]), found) < 0.4
    # Finished, it is what adding the log gives; those before are what they were.
    session.finish("b.csv")
    again.add_log(session.given[1])
    np.testing.assert_array_equal(session.graph.p, again.graph.p)
    assert session.result().is_connected
    np.testing.assert_array_equal(lone.session.graph.p, before)


def test_bad_samples_are_refused_and_harm_nothing():
    log, _ = drifting_walk(Place(1), 1)
    session = mm.Session()
    with pytest.raises(ValueError, match="add"):
        session.pose()
    with pytest.raises(ValueError, match="no log yet"):
        session.result()
    feed(session, log, range(20))
    T = RigidTransform.identity()
    for t, field, said in [
        (log.times[19], [3e-5, 0, 0], "expected a time after"),
        (0.5, [3e-5, 0, 0], "expected a time after"),
        (np.nan, [3e-5, 0, 0], "t"),
        (100.0, [np.nan, 0, 0], "field"),
        (100.0, [3e-5, 0], "field"),
        (100.0, [30.0, 0, 0], "multiply by 1e-6"),
    ]:
        with pytest.raises(ValueError, match=said):
            session.add(t, T, field)
    with pytest.raises(TypeError, match="T_odom_body"):
        session.add(100.0, np.eye(4), [3e-5, 0, 0])
    with pytest.raises(ValueError, match="T_odom_body: expected finite numbers"):
        session.add(100.0, RigidTransform.from_translation([np.inf, 0, 0]), [3e-5, 0, 0])
    feed(session, log, range(20, 40))
    session.finish("walk.csv")
    assert len(session.given[0]) == 40


def test_a_robot_that_stands_stays_where_it_is():
    rng = np.random.default_rng(0)
    session = mm.Session()
    for k in range(300):
        T = RigidTransform.from_translation(0.002 * rng.normal(size=3))
        session.add(0.1 * k, T, 3e-5 + 2e-7 * rng.normal(size=3))
    assert np.abs(session.pose().translation).max() < 0.02
    with pytest.raises(ValueError, match="no log yet"):
        session.result()


@pytest.mark.slow
def test_who_stood_for_long_is_searched_soon_after():
    log, _ = drifting_walk(Place(1), 1, laps=2.6)
    rng, n = np.random.default_rng(0), 1500
    stood = np.concatenate([np.zeros(n, np.int64), np.arange(len(log))])
    jitter = np.where(np.arange(len(stood))[:, None] < n, 0.002 * rng.normal(size=(len(stood), 3)), 0.0)
    walk = replace(
        log.subset(np.arange(len(log))), positions=log.positions[stood] + jitter, field=log.field[stood],
        orientations=log.orientations[stood], times=0.1 * np.arange(len(stood)),
    )  # fmt: skip
    session = mm.Session()
    feed(session, walk)
    assert session.result().status == "connected"


def test_merged_surveys_take_no_log_that_drifts():
    session = mm.Session(PRESETS["default"])
    with pytest.raises(TypeError, match="merge"):
        session.add(0.0, RigidTransform.identity(), [3e-5, 0, 0])
