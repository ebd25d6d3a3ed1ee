# SPDX-License-Identifier: BSD-3-Clause
"""Known errors of clock and sensor are found again; a clean log is left as it is; what cannot be known is said."""

from dataclasses import replace

import numpy as np
import pytest

from magmatch.preparation.config import PreparationConfig
from magmatch.preparation.prepare import prepare

FAST = PreparationConfig.model_validate({"disturbances": {"spikes": "off", "moving_metal": "off"}})


@pytest.fixture(scope="module")
def prepared(hand_held):
    return prepare(hand_held[1], FAST)


def test_clock_hard_iron_and_soft_iron_are_found(prepared, hand_held):
    """Within 3 ms, three tenths of a microtesla and half a percent."""
    (_, report), truth = prepared, hand_held[2]
    steps = [report[name] for name in ("time offset", "hard iron", "soft iron")]
    assert [step.outcome for step in steps] == ["applied"] * 3
    clock, hard, soft = (step.figures for step in steps)
    assert clock["estimate"][0] == pytest.approx(truth.clock_offset, abs=3e-3)
    np.testing.assert_allclose(hard["hard_iron"], truth.hard_iron, rtol=0, atol=0.3e-6)
    of_no_gain = truth.soft_iron / np.cbrt(np.linalg.det(truth.soft_iron))
    np.testing.assert_allclose(soft["soft_iron"], of_no_gain, rtol=0, atol=5e-3)


def test_the_prepared_field_is_the_clean_one_to_its_noise(prepared, hand_held):
    clean, raw, corruption = hand_held
    survey = prepared[0]
    # The same readings, by their stamps on the poses' clock.
    there = np.column_stack([np.interp(survey.times, clean.times, b) for b in clean.field.T])
    before = np.column_stack([np.interp(raw.times + corruption.clock_offset, clean.times, b) for b in clean.field.T])
    error = np.sqrt(((survey.field - there) ** 2).mean())
    assert error < 0.5e-6
    assert np.sqrt(((raw.field - before) ** 2).mean()) > 10 * error


def test_a_clean_log_is_left_as_it_is(hand_held):
    clean = hand_held[0]
    survey, report = prepare(clean)
    assert survey is clean
    assert {step.outcome for step in report.steps} <= {"off", "unchanged", "unknown"}


def test_a_robot_that_turns_about_the_vertical_only_is_told_so(robot):
    _, raw, corruption = robot
    _, report = prepare(raw, FAST)
    hard = report["hard iron"]
    assert hard.figures["is_open"] == [False, False, True]
    assert hard.figures["estimate"][2] == pytest.approx(0, abs=1e-9)
    np.testing.assert_allclose(hard.figures["hard_iron"][:2], corruption.hard_iron[:2], rtol=0, atol=0.8e-6)
    assert "z not separable" in hard.words
    assert "zz not separable" in report["soft iron"].words
    assert report["time offset"].figures["estimate"][0] == pytest.approx(corruption.clock_offset, abs=4e-3)


def test_without_orientations_nothing_is_guessed(hand_held):
    blind = replace(hand_held[1], orientations=None)
    survey, report = prepare(blind, FAST)
    assert survey is blind
    for name in ("time offset", "hard iron", "soft iron", "misalignment"):
        assert report[name].outcome == "unknown"
        assert "orientations" in report[name].words


def test_a_sensor_that_never_turned_tells_nothing_about_its_hard_iron(robot):
    clean = robot[0]
    still = replace(clean, orientations=clean.orientations[np.zeros(len(clean), dtype=int)])
    survey, report = prepare(still, FAST)
    assert survey is still
    assert report["hard iron"].figures["is_open"] == [True, True, True]
