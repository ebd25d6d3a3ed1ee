# SPDX-License-Identifier: BSD-3-Clause
"""Axes that are stuck or at the end of their range are found in the sensor's own axes, and no others."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from magmatch.data.checks import check_survey
from magmatch.data.sensor_axes import at_limit, stuck_axes
from magmatch.data.survey import Survey

UT = 1e-6
N = 1200


def hand_held(change=lambda b: b, seed=0, tilt=0.9):
    """A sensor turned about every axis as it is carried; its readings after some change."""
    rng, t = np.random.default_rng(seed), 0.05 * np.arange(N)
    q = Rotation.from_euler("zyx", np.c_[0.7 * t, tilt * np.sin(0.9 * t), tilt * np.cos(0.7 * t)])
    x = np.c_[3 * np.sin(0.31 * t), 2 * np.sin(0.47 * t), 1 + 0.2 * np.sin(0.2 * t)]
    field = np.array([18, 3, -40]) * UT + 3 * UT * np.sin(1.5 * x)
    readings = change(q.apply(field, inverse=True) + rng.normal(0, 0.2 * UT, (N, 3)))
    return Survey(x, q.apply(readings), t, q, name="log")


def with_axis(axis, values):
    """A change of one axis."""
    return lambda b: np.where(np.arange(3) == axis, np.broadcast_to(values(b), b.shape), b)


STUCK = {
    "one value": with_axis(1, lambda b: np.full_like(b, -1.5 * UT)),
    "at its limit": with_axis(1, lambda b: np.maximum(b, 9 * UT)),
    "now and then another": with_axis(1, lambda b: np.where(np.arange(N)[:, None] % 7 == 0, b, 2 * UT)),
    "its last digit": with_axis(1, lambda b: np.where(b > b.mean(axis=0), -1.5 * UT, -1.4 * UT)),
    "noise alone": with_axis(1, lambda b: 1e-2 * b),
    "zero": with_axis(1, lambda b: 0 * b),
}


@pytest.mark.parametrize("case", STUCK)
def test_an_axis_that_is_stuck_is_named_in_the_sensors_own_axes(case):
    survey = hand_held(STUCK[case])
    (words,) = stuck_axes(survey)
    assert words.startswith("the sensor's y axis ")
    assert any("the sensor's y axis" in said and "nothing is estimated" in said for said in check_survey(survey))


def test_readings_that_end_at_a_limit_are_found_though_they_were_turned_there_and_back():
    survey = hand_held(lambda b: np.clip(b, -38 * UT, 38 * UT))
    read = survey.orientations.apply(survey.field, inverse=True)
    assert not stuck_axes(survey)
    expected = np.abs(np.abs(read) - 38 * UT) < 1e-12
    assert expected.any(axis=1).mean() > 0.02
    assert np.array_equal(at_limit(read), expected)
    assert any("z axis is at the end of its range, -38 uT" in said for said in check_survey(survey))


@pytest.mark.parametrize("digit", [0.0, 0.15, 0.6])
@pytest.mark.parametrize("tilt", [0.9, 0.05, 0.0])
def test_a_healthy_sensor_in_any_digits_is_neither(digit, tilt):
    survey = hand_held(lambda b: b if digit == 0 else np.round(b / (digit * UT)) * digit * UT, tilt=tilt)
    read = survey.orientations.apply(survey.field, inverse=True)
    assert not stuck_axes(survey)
    assert not at_limit(read).any()


def test_without_orientations_a_component_that_is_one_value_is_named():
    survey = hand_held()
    flat = replace(survey, field=survey.field * [1, 1, 0], orientations=None)
    assert [words for words in check_survey(flat) if "the field's z component reads 0 nT" in words]


ALIKE = {
    "the same": lambda b: b[:, [0, 0, 2]],
    "reversed": lambda b: b[:, [0, 0, 2]] * [1, -1, 1],
    "noise apart": lambda b: b[:, [0, 0, 2]] + np.random.default_rng(1).normal(0, 0.1 * UT, (N, 3)),
}


@pytest.mark.parametrize("case", ALIKE)
def test_two_axes_that_read_the_same_are_named(case):
    (words,) = stuck_axes(hand_held(ALIKE[case]))
    assert words.startswith("the sensor's x axis and the sensor's y axis read the same")


@pytest.mark.parametrize("share", [0.15, 0.5])
def test_an_axis_that_is_stuck_for_a_while_is_named_with_its_times(share):
    held = np.arange(N)[:, None] > (1 - share) * N
    (words,) = stuck_axes(hand_held(with_axis(1, lambda b: np.where(held, 2 * UT, b))))
    assert words.startswith("the sensor's y axis reads 2 uT from")
    assert words.endswith("to 59.95 s, though it turned")


def test_rows_of_zeros_are_no_end_of_a_range():
    survey = hand_held(lambda b: b * (np.arange(N) % 7 > 0)[:, None])
    assert not any("end of its range" in words for words in check_survey(survey))


def test_a_limit_is_said_once_however_it_was_turned():
    (words,) = [w for w in check_survey(hand_held(with_axis(2, lambda b: np.minimum(b, -26 * UT)))) if "axis" in w]
    assert words.count("uT") == 1


def test_readings_held_by_a_sensor_that_turns_are_repeats():
    survey = hand_held(lambda b: b[np.arange(N) // 3 * 3])
    assert any("67 % of the samples repeat the field" in words for words in check_survey(survey))
