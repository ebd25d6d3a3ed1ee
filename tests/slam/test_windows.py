# SPDX-License-Identifier: BSD-3-Clause
"""Logs in windows: every sample in one, in order, of equal path; between them a correction changes evenly.

Odometry bends them by the slopes of a dead reckoning that is off by a little. One that it may bend as far as the
field changes fits wherever it is laid: it closes nothing.
"""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial.transform import RigidTransform, Rotation

from drifting import Place, drifting_walk, submap_at
from magmatch.data.survey import Survey
from magmatch.preparation.odometry.drift import OdometryConfig, lie_level
from magmatch.slam.config import SlamConfig
from magmatch.slam.graph.odometry import odometry_graph
from magmatch.slam.graph.trajectories import corrected
from magmatch.slam.result import SlamStatus
from magmatch.slam.run import slam
from magmatch.slam.search.loop_closure import SAME_SHIFT, Rough, matches
from magmatch.slam.windows import bend, cut, lasting_errors

LOG, _ = drifting_walk(Place(1), 1)
CONFIG = SlamConfig(window_length=6.0, is_planar=True)


@given(st.lists(st.floats(0.3, 2.0), min_size=1, max_size=3), st.floats(0.2, 3.0))
@settings(max_examples=20, deadline=None)
def test_every_sample_lies_in_one_window_and_nodes_count_on(laps, length):
    logs = [drifting_walk(Place(1), k, laps=some)[0] for k, some in enumerate(laps)]
    paths = cut(logs, length, CONFIG)
    assert [node for path in paths for node in path.nodes] == list(range(sum(len(p.windows) for p in paths)))
    for k, (log, path) in enumerate(zip(logs, paths, strict=True)):
        assert len(path.number) == len(log)
        assert (np.diff(path.number) >= 0).all()
        assert sum(len(w.survey) for w in path.windows) == len(log)
        assert {w.log for w in path.windows} == {k}
        assert (path.number[path.middles] == np.arange(len(path.windows))).all()
        spans = [np.ptp(path.walked[path.number == w]) for w in range(len(path.windows))]
        assert max(spans) <= path.walked[-1] / len(path.windows) + 1e-9


def test_a_log_that_moves_as_a_whole_moves_so_in_every_sample():
    (path,) = cut([LOG], 0.8, CONFIG)
    graph = odometry_graph([path], CONFIG)
    T = RigidTransform.from_components([3.0, 1.0, 0.0], Rotation.from_rotvec([0.0, 0.0, 2.0]))
    graph.p, graph.R = T.apply(graph.p), T.rotation.as_matrix() @ graph.R
    after, moved = corrected(path, graph), LOG.transformed(T)
    np.testing.assert_allclose(after.positions, moved.positions, atol=1e-9)
    np.testing.assert_allclose(after.field, moved.field, atol=1e-15)


@pytest.mark.parametrize(
    ("turn", "rise", "level"),
    [([0, 0, 1.0], 0.0, True), ([0, 0, 1.0], 1.0, False), ([1.0, 0, 0], 0.0, False), (None, 0.0, True)],
)
def test_logs_are_level_where_height_and_tilt_stay(turn, rise, level):
    rng = np.random.default_rng(0)
    n = 50
    p = np.column_stack([rng.normal(size=(n, 2)), np.linspace(0, rise, n)])
    mounted = Rotation.from_rotvec([0.5, 1.0, 0.0])
    R = None if turn is None else Rotation.from_rotvec(np.linspace(0, 3, n)[:, None] * turn) * mounted
    log = Survey(p, np.full((n, 3), 3e-5), orientations=R)
    assert lie_level([log]) == level


RNG = np.random.default_rng(3)
PATH = np.cumsum(RNG.normal(size=(9, 3)), axis=0)
STEPS = np.diff(PATH, axis=0)
LENGTHS = np.linalg.norm(STEPS, axis=1)
ODOMETRY = OdometryConfig(sd=(0.4, 5.0), scale_sd=0.03, turn_share=0.4)
SMALL = 1e-7


def dead_reckoned(turns, shifts, scale, about):
    """Turn and shift of each point, where each step turns about its middle, and one point stays as it was."""
    R, p = [Rotation.identity()], [PATH[0]]
    for step, turn, shift in zip(STEPS, turns, shifts, strict=True):
        half = (1 + scale) * step / 2
        R.append(R[-1] * Rotation.from_rotvec(turn))
        p.append(p[-1] + R[-2].apply(half) + R[-1].apply(half) + R[-2].apply(shift))
    back = R[about].inv()
    return (
        np.array([(back * r).as_rotvec() for r in R]),
        np.array([back.apply(q - p[about]) + PATH[about] for q in p]) - PATH,
    )


@pytest.mark.parametrize("about", [0, 4, 8])
@pytest.mark.parametrize(("upright", "planar"), [(False, False), (True, False), (True, True)])
def test_loads_are_the_slopes_of_dead_reckoning(about, upright, planar):
    loads = bend(PATH, about, ODOMETRY, upright=upright, planar=planar)
    turning, moving = ([2] if upright else [0, 1, 2]), ([0, 1] if planar else [0, 1, 2])
    n = len(STEPS)
    assert loads.shape == (len(PATH), 6, n * (len(turning) + len(moving)) + 2)
    column = 0
    for kind, axes, sd in (("turn", turning, ODOMETRY.rotation_sd), ("shift", moving, ODOMETRY.translation_sd)):
        for axis in axes:
            for k in range(n):
                errors = np.zeros((n, 3))
                errors[k, axis] = SMALL * sd * np.sqrt(LENGTHS[k])
                turns, shifts = (errors, 0 * errors) if kind == "turn" else (0 * errors, errors)
                expected = np.concatenate(dead_reckoned(turns, shifts, 0.0, about), axis=1) / SMALL
                np.testing.assert_allclose(loads[:, :, column], expected, atol=1e-4)
                column += 1


@pytest.mark.parametrize("about", [0, 5])
def test_lasting_errors_are_the_slopes_of_scale_and_turn_rate(about):
    found = lasting_errors(PATH, about, upright=True)
    none = np.zeros((len(STEPS), 3))
    scaled = np.concatenate(dead_reckoned(none, none, SMALL, about), axis=1) / SMALL
    turned_on = dead_reckoned(SMALL * LENGTHS[:, None] * [0.0, 0.0, 1.0], none, 0.0, about)
    np.testing.assert_allclose(found[:, :, 0], scaled, atol=1e-4)
    np.testing.assert_allclose(found[:, :, 1], np.concatenate(turned_on, axis=1) / SMALL, atol=1e-4)


def test_without_an_upright_carrier_no_turn_rate_lasts():
    assert not lasting_errors(PATH, 0, upright=False)[:, :, 1].any()


def test_logs_that_odometry_may_bend_at_will_stay_as_they_came_and_are_told_why():
    log, _ = drifting_walk(Place(1), 1)
    session = slam(log, SlamConfig(odometry=OdometryConfig(sd=(2.0, 4.0))))
    result = session.result()
    assert result.status is SlamStatus.UNCHANGED
    assert "odometry may bend" in result.reason
    assert "--odometry-sd" in result.reason
    assert not session.graph.closures


@pytest.mark.parametrize("seed", range(2))
def test_a_window_that_is_bent_by_half_a_field_length_is_found_and_known_for_what_it_is(lone, seed):
    """The field is not linear over so much: the shape has to be fitted for the evidence to be seen."""
    places = lone.session._now
    closure = max(places.graph.closures, key=lambda c: c.log_odds)
    one = places.paths[0].windows[closure.second]
    odometry = OdometryConfig(sd=(0.6, 8.0), scale_sd=0.0, turn_share=0.0)
    window = replace(one, config=one.config.model_copy(update={"odometry": odometry}))
    assert 0.5 < window.bends_by / window.length < 0.6
    T = places.graph.center(closure.first) * closure.T_first_second * window.T_log_node.inv()
    rough = Rough(T, np.diag([0.01, 0.01, 0.1, 0.3, 0.3, 0.05]) ** 2)
    found = matches(bent(window, seed), submap_at(places, closure.first), rough)[0]
    off = found.T_base_log.apply(window.center) - T.apply(window.center)
    assert np.linalg.norm(off[:2]) < SAME_SHIFT * window.length
    assert found.log_odds > 5


def bent(window, seed):
    """The window as odometry may have bent it: with one draw of its errors."""
    errors = np.random.default_rng(seed).standard_normal(window.bending.shape[2])
    off, T = window.bending @ errors, window.walk.T_survey_walk
    bins, survey = T.apply(window.walk.positions), window.survey
    nearest = np.argmin(np.linalg.norm(survey.positions[:, None] - bins, axis=2), axis=1)
    turn, shift = (T.rotation.apply(part)[nearest] for part in (off[:, :3], off[:, 3:]))
    field = Rotation.from_rotvec(-turn).apply(survey.field)
    return replace(window, survey=replace(survey, positions=survey.positions - shift, field=field, orientations=None))
