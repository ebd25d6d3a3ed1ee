# SPDX-License-Identifier: BSD-3-Clause
"""Jumps of a sensor's own calibration are found, told from what is none, and taken out."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from magmatch.data.diagnoses import diagnose
from magmatch.data.survey import Survey
from magmatch.preparation.config import PreparationConfig
from magmatch.preparation.prepare import prepare, prepare_either
from magmatch.preparation.recalibrations import find_recalibrations
from magmatch.preparation.sensor_log import SensorLog

UT = 1e-6
QUICK = PreparationConfig.model_validate(
    {
        "time_offset": {"mode": "off"},
        "calibration": {"soft_iron": "off", "misalignment": "off"},
        "disturbances": {"spikes": "off", "moving_metal": "off"},
        "n_samples": 600,
    }
)


def turned(steps=(), seed=0, n=400, noise=0.3 * UT):
    """A sensor that turns in a slowly changing field; `steps` are (row, (3,) T in its frame) added from there on."""
    rng = np.random.default_rng(seed)
    t = 0.02 * np.arange(n)
    orientations = Rotation.from_euler("zyx", np.column_stack([t, 0.4 * np.sin(t), 0.3 * np.cos(2 * t)]))
    field = np.array([18, 3, -45]) * UT + 5 * UT * np.column_stack([np.sin(t), np.cos(0.7 * t), np.sin(1.3 * t)])
    readings = orientations.apply(field, inverse=True) + rng.normal(0, noise, (n, 3))
    for row, step in steps:
        readings[row:] += step
    return SensorLog.of(Survey(np.column_stack([t, 0 * t, 0 * t]), orientations.apply(readings), t, orientations))


def is_like_a_turn(log, row, step):
    """Whether a step leaves the vertical field and the size of the horizontal one nearly as they were."""
    before = log.orientations[row].apply(log.readings[row])
    after = log.orientations[row].apply(log.readings[row] + step)
    change = np.hypot(np.hypot(*after[:2]) - np.hypot(*before[:2]), after[2] - before[2])
    return change < 0.5 * np.linalg.norm(step)


vectors = st.tuples(*[st.floats(-60, 60)] * 3).map(lambda v: np.array(v) * UT)


@settings(max_examples=40, deadline=None)
@given(row=st.integers(20, 380), step=vectors, seed=st.integers(0, 99))
def test_a_jump_is_found_where_it_is_and_measured(row, step, seed):
    log = turned([], seed)
    if np.linalg.norm(step) < 6 * UT or is_like_a_turn(log, row, step):
        return
    found = find_recalibrations(turned([(row, step)], seed))
    assert found.rows.tolist() == [row]
    np.testing.assert_allclose(found.steps[0], step, atol=2.5 * UT)
    joined = found.joined(turned([(row, step)], seed)).readings
    plain = log.readings + (step if row < 200 else 0)
    np.testing.assert_allclose(joined, plain, atol=2.5 * UT)


def posed(n, positions, readings_of):
    """A log of a sensor that does not turn; readings of its places."""
    survey = Survey(positions, readings_of(positions), 0.05 * np.arange(n), Rotation.identity(n))
    return SensorLog.of(survey)


def wavy(x, noise=0.3 * UT):
    """A field of 5 uT that changes over a metre."""
    rng = np.random.default_rng(0)
    b = np.array([18, 3, -45]) * UT + 5 * UT * np.column_stack([np.sin(x), np.cos(1.3 * x), np.sin(2 * x)])
    return b + rng.normal(0, noise, (len(x), 3))


def test_readings_that_are_held_hide_no_jump_and_are_none():
    n = 1200
    x = 0.01 * np.arange(n)
    held = wavy(x)[np.arange(n) // 10 * 10]
    log = posed(n, np.column_stack([x, 0 * x, 0 * x]), lambda _: held)
    assert len(find_recalibrations(log)) == 0
    jumped = held + np.where(np.arange(n)[:, None] < 600, 0, [12e-6, 0, 0])
    found = find_recalibrations(posed(n, np.column_stack([x, 0 * x, 0 * x]), lambda _: jumped))
    assert found.rows.tolist() == [600]


def test_a_carrier_that_stops_and_goes_does_not_recalibrate_its_sensor():
    n = 600
    x = 0.6 * (np.arange(n) // 12)
    assert len(find_recalibrations(posed(n, np.column_stack([x, 0 * x, 0 * x]), lambda p: wavy(p[:, 0])))) == 0


def test_a_spike_a_gap_and_the_end_of_the_range_are_no_jumps():
    spike = turned([(100, np.full(3, 40 * UT)), (101, np.full(3, -40 * UT))])
    assert len(find_recalibrations(spike)) == 0
    jump = turned([(100, np.full(3, 40 * UT))])
    times = jump.times + 5.0 * (np.arange(400) >= 100)
    assert len(find_recalibrations(replace(jump, times=times))) == 0
    held = replace(jump, readings=np.minimum(turned([]).readings, 10 * UT))
    assert len(find_recalibrations(held)) == 0


@pytest.fixture(scope="module")
def phone(hand_held):
    """The clean log; it with a bias that jumps twice; it with a large bias that stays."""
    clean = hand_held[0]
    bias = np.zeros((len(clean), 3))
    bias[:] = [4 * UT, 0, 3 * UT]
    bias[len(clean) // 3 :] += [20 * UT, -15 * UT, 5 * UT]
    bias[600:] += [0, 8 * UT, -8 * UT]
    return clean, biased(clean, bias), biased(clean, np.array([120 * UT, -80 * UT, 200 * UT]))


def biased(survey, bias):
    R = survey.orientations
    return replace(survey, field=R.apply(R.apply(survey.field, inverse=True) + bias))


def error(survey, clean):
    return float(np.sqrt(((survey.field - clean.field) ** 2).sum(axis=1).mean()))


def test_a_log_that_jumped_is_prepared_as_if_it_had_not(phone):
    clean, jumping, _ = phone
    prepared, report = prepare(jumping, QUICK)
    step = next(step for step in report.steps if step.step == "recalibration")
    assert step.outcome == "applied"
    np.testing.assert_allclose(step.figures["times"], clean.times[[len(clean) // 3, 600]])
    assert error(jumping, clean) > 15 * UT
    assert error(prepared, clean) < 0.5 * UT
    assert "recalibrated itself at" in step.words


@pytest.mark.slow
def test_the_readings_with_the_smaller_misfit_are_taken(phone):
    clean, jumping, raw = phone
    uncut = QUICK.model_copy(update={"recalibration": "off"})
    for own, other, taken in ((jumping, raw, "raw"), (clean, biased(jumping, 50 * UT), "own")):
        prepared, report = prepare_either(own, other, uncut)
        step = report.steps[0]
        assert step.step == "magnetometer"
        assert step.figures["taken"] == taken
        assert step.after is not None
        assert (step.after < step.before) == (taken == "raw")
        assert error(prepared, clean) < 0.5 * UT


def squares(pose_seconds, sensor_seconds, lag=0.0, seed=0, corner=np.pi / 2, axis=2):
    """A sensor carried round two squares, which turns at the corners in some seconds; what the poses say of that."""
    t = 0.1 * np.arange(640)
    rng = np.random.default_rng(seed)
    side, rest = np.divmod(t, 8.0)
    corners = np.array([[0, 0], [8, 0], [8, 8], [0, 8]])[side.astype(int) % 4]
    towards = np.array([[1, 0], [0, 1], [-1, 0], [0, -1]])[side.astype(int) % 4]
    positions = np.column_stack([corners + towards * rest[:, None], 0 * t])

    def attitudes(t, seconds):
        turns = sum(np.clip((t - 8.0 * k) / max(seconds, 1e-6) + 0.5, 0, 1) for k in range(1, 8))
        return Rotation.from_rotvec(corner * turns[:, None] * np.eye(3)[axis])

    field = np.array([0, 25, -36]) * UT + 3 * UT * np.sin(positions / 1.4 + [0, 1, 2])
    readings = attitudes(t, sensor_seconds).apply(field, inverse=True) + rng.normal(0, 0.3 * UT, (len(t), 3))
    told = attitudes(t - lag, pose_seconds)
    return Survey(positions, told.apply(readings), t, told)


@pytest.mark.parametrize(("pose_seconds", "sensor_seconds", "lag"), [
    (0.0, 1.0, 0.0), (0.0, 1.0, 0.3), (0.0, 0.5, -0.2), (1.0, 0.0, 0.0), (0.5, 0.0, 0.4), (0.0, 0.0, 0.5),
])  # fmt: skip
def test_a_turn_that_poses_show_late_or_early_is_no_jump_of_the_sensor(pose_seconds, sensor_seconds, lag):
    log = SensorLog.of(squares(pose_seconds, sensor_seconds, lag))
    assert len(find_recalibrations(log)) == 0


@pytest.mark.parametrize("axis", [0, 1])
def test_a_tilt_that_poses_show_at_once_is_no_jump_of_the_sensor(axis):
    log = SensorLog.of(squares(0.0, 1.0, corner=0.6, axis=axis))
    assert len(find_recalibrations(log)) == 0


def test_a_frame_is_not_wrong_because_poses_show_turns_late():
    assert not diagnose(squares(0.0, 1.0))


def test_corrections_of_poses_that_step_leave_the_magnitude_as_it_was_read():
    survey = squares(0.0, 1.0, lag=0.2)
    prepared, report = prepare(survey, QUICK)
    assert report["recalibration"].outcome == "unchanged"
    read, left = (np.linalg.norm(s.field, axis=1) for s in (survey, prepared))
    assert left.std() < 1.3 * read.std()
    assert abs(np.median(left) - np.median(read)) < 2 * UT
