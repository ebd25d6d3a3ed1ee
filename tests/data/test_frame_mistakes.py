# SPDX-License-Identifier: BSD-3-Clause
"""A matrix of planted mistakes in a sensor's axes: what is advised makes the vectors right, or nothing is advised."""

import re
from dataclasses import replace
from itertools import permutations, product

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from magmatch.data.diagnoses import diagnose
from magmatch.data.formats.format import SurveyFormat
from magmatch.data.frame_mistakes import AXES, OWN, named
from magmatch.data.read import read_survey
from magmatch.data.survey import Survey
from magmatch.preparation.config import PreparationConfig
from magmatch.preparation.prepare import prepare
from magmatch.registration.advice import diagnosis

QUICK = PreparationConfig.model_validate({"disturbances": {"spikes": "off", "moving_metal": "off"}})
# The 48 ways, by the permutation: of both handednesses.
WAYS = {
    order: [np.eye(3)[list(order)] * np.array(signs)[:, None] for signs in product([1.0, -1.0], repeat=3)]
    for order in permutations(range(3))
}


def log(kind, n=400, iron=(0.0, 0.0, 0.0), seed=0):
    """Round a hall, in a hand that turns every way or on a robot that yaws; field in the survey's frame."""
    rng, t = np.random.default_rng(seed), np.linspace(0, 6 * np.pi, n)
    positions = np.column_stack([5 * np.cos(t), 3 * np.sin(t) + np.sin(3 * t), 0.2 * np.sin(5 * t)])
    waves, phases = rng.normal(0, 0.8, (15, 3)), rng.uniform(0, 6.3, (3, 15))
    anomalies = np.column_stack([np.sin(positions @ waves.T + phase).sum(axis=1) for phase in phases])
    steps = np.gradient(positions, axis=0)
    angles = np.column_stack(
        [np.arctan2(steps[:, 1], steps[:, 0]), 0.6 * np.sin(1.7 * t), 0.5 + 0.5 * np.cos(2.3 * t)]
    )
    q = Rotation.from_euler("ZYX", angles * [1, kind == "hand", kind == "hand"])
    field = np.array([18e-6, 3e-6, -43e-6]) + 1e-6 * anomalies + rng.normal(0, 2e-7, (n, 3)) + q.apply(iron)
    return Survey(positions, field, 0.1 * np.arange(n), q, name=f"{kind}.csv")


def with_axes(survey, axes):
    """The survey by a sensor whose readings are in other axes."""
    read = survey.orientations.apply(survey.field, inverse=True)
    return replace(survey, field=survey.orientations.apply(read @ axes.T))


def unturned(survey):
    """The survey, its readings left in the sensor's axes."""
    return replace(survey, field=survey.orientations.apply(survey.field, inverse=True))


def advised(told):
    """The matrices of axes that a diagnosis names."""
    every = {named(axes): axes for ways in WAYS.values() for axes in ways}
    return [every[words] for words in re.findall(r"\((-?[xyz], -?[xyz], -?[xyz])\)", told)]


@pytest.mark.parametrize("order", WAYS)
def test_each_permutation_of_a_hand_held_sensors_axes_is_told_with_its_signs(order):
    survey = log("hand")
    for axes in WAYS[order]:
        found = diagnose(with_axes(survey, axes))
        if np.array_equal(np.abs(axes), np.eye(3)) and abs(np.trace(axes)) == 3:
            # All reversed: no motion tells a reversed field.
            assert found == []
            continue
        (way,) = advised(str(found[0]))
        np.testing.assert_array_equal(way, axes.T)
        assert ("--extrinsic" in found[0].remedy) == (np.linalg.det(axes) > 0)


@pytest.mark.parametrize("order", WAYS)
def test_of_a_robot_that_yaws_the_ways_that_are_not_told_apart_are_all_named_or_nothing_is(order):
    survey = log("robot")
    for axes in WAYS[order][:4]:  # the others reverse all, which no motion tells
        for told in map(str, diagnose(with_axes(survey, axes))):
            assert "rename" not in told
            assert "invert" not in told
            assert "--field-frame" not in told
            ways = advised(told)
            assert not ways or any(np.array_equal(way, sign * axes.T) for way in ways for sign in (1, -1))


@pytest.mark.parametrize("kind", ["hand", "robot"])
@pytest.mark.parametrize("iron", [(0, 0, 0), (3e-5, -1e-5, 2e-5)])
def test_healthy_logs_are_told_of_nothing(kind, iron):
    for seed in range(3):
        assert diagnose(log(kind, iron=iron, seed=seed)) == []


@pytest.mark.parametrize("iron", [(0, 0, 0), (1e-5, -2e-5, 1e-5)])
@pytest.mark.parametrize("degrees", [30, 45, 75, 110, 150])
def test_a_mount_that_is_no_permutation_is_told_by_its_rotation(degrees, iron):
    survey = log("hand", iron=iron)
    turn = Rotation.from_rotvec(np.radians(degrees) * np.array([0.48, 0.6, 0.64]))
    (found,) = diagnose(with_axes(survey, turn.as_matrix()))
    numbers = [float(v) for v in re.search(r"--extrinsic '0 0 0 ([^']*)'", found.remedy)[1].split()]
    assert (Rotation.from_quat(numbers) * turn).magnitude() < np.radians(10)


def test_axes_and_a_forgotten_frame_are_told_together():
    for name in ("y, x, -z", "-z, x, -y", OWN):
        (found,) = diagnose(unturned(with_axes(log("hand"), AXES[name])))
        assert "--field-frame sensor" in found.remedy
        assert [named(way.T) for way in advised(str(found))] == [name] * (name != OWN)


def test_headings_that_step_at_corners_and_a_path_that_turns_once_are_told_of_nothing():
    rng, s = np.random.default_rng(0), np.arange(0, 64, 0.1)
    side, along = (s // 8).astype(int), (s % 8)[:, None]
    corners, ways = np.array([[0, 0], [8, 0], [8, 8], [0, 8]]), np.array([[1, 0], [0, 1], [-1, 0], [0, -1]])
    xy = corners[side % 4] + ways[side % 4] * along
    waves = np.column_stack([np.sin(xy[:, 0] / 1.5), np.cos(xy[:, 1] / 1.3), np.sin(xy.sum(axis=1) / 2)])
    turned = Rotation.from_euler("z", np.interp(s, *_corners())[:, None])
    read = turned.apply([0, 2.5e-5, -3.6e-5] + 3e-6 * waves + rng.normal(0, 3e-7, (len(s), 3)), inverse=True)
    q = Rotation.from_euler("z", np.pi / 2 * side[:, None])
    square = Survey(np.column_stack([xy, 0 * s]), q.apply(read), s, q)
    assert diagnose(square) == []
    rows = np.arange(30, 130)
    for wild in np.random.default_rng(1).normal(0, 1.2e-5, (8, 2, 3)):
        steel = wild[0] + (wild[1] - wild[0]) * (side[rows] > 0)[:, None]
        assert diagnose(replace(square.subset(rows), field=square.field[rows] + steel)) == []


def _corners():
    """Where the square's walker begins and ends to turn, and the headings."""
    times = [t for k in range(1, 8) for t in (8 * k - 0.5, 8 * k + 0.5)]
    return [0, *times, 64], np.pi / 2 * np.array([0, *(k + j for k in range(7) for j in (0, 1)), 7])


def test_following_the_advice_makes_the_vectors_right(tmp_path):
    survey, path = log("hand", n=300), tmp_path / "log.csv"
    for axes in (AXES["y, x, -z"], -AXES["y, x, -z"], np.diag([1.0, -1.0, 1.0])):
        unturned(with_axes(survey, axes)).save(path)
        (found,) = (
            one for one in diagnose(read_survey(path, SurveyFormat(field_frame="sensor"))) if one.is_of_frames
        )
        options = re.findall(r"--(columns|extrinsic) '?([^';]*?)'?(?: or |;)", found.remedy)
        assert len(options) == 1 + (np.linalg.det(axes) > 0)
        for option, value in options:
            again = read_survey(path, SurveyFormat(field_frame="sensor", **{option: value}))
            np.testing.assert_allclose(again.field, survey.field, atol=1e-8)
            assert diagnose(again) == []


def test_prepare_says_of_axes_that_are_wrong_what_the_diagnosis_says_and_corrects_nothing():
    wrong = with_axes(log("hand"), AXES["y, x, -z"])
    left, report = prepare(wrong, QUICK)
    assert left is wrong
    words = {step.step: step.words for step in report.steps}
    assert all("another frame" in words[name] for name in ("time offset", "hard iron", "soft iron", "misalignment"))
    assert not any("turned too little" in text for text in words.values())


def test_an_option_in_advice_about_one_of_two_surveys_is_that_surveys_own():
    wrong = with_axes(log("hand"), AXES["y, x, -z"])
    said = diagnosis({"base": log("hand"), "target": wrong})
    assert "--target-extrinsic '0 0 0 " in said
    assert "--target-columns bx=by,by=bx,bz=-bz" in said


@pytest.mark.parametrize(("lag", "tilt", "spin"), [(10, 0.3, 1.1), (10, 0.6, 1.1), (-14, 0.6, 0.7)])
def test_readings_that_come_late_or_early_are_neither_a_mount_nor_another_frame(lag, tilt, spin):
    rng, n = np.random.default_rng(0), 600
    t = 0.05 * np.arange(n)
    q = Rotation.from_euler("zyx", np.column_stack([spin * t, tilt * np.sin(0.9 * t), tilt * np.cos(0.7 * t)]))
    x = np.column_stack([3 * np.sin(0.31 * t), 2 * np.sin(0.47 * t), 1 + 0.2 * np.sin(0.2 * t)])
    field = np.array([18e-6, 3e-6, -40e-6]) + 1e-6 * np.sin(1.5 * x)
    read = q.apply(field, inverse=True) + rng.normal(0, 2e-7, (n, 3))
    (told,) = diagnose(Survey(x, q.apply(np.roll(read, lag, axis=0)), t, q).subset(slice(20, -20)))
    assert f"{abs(lag) / 20:.1g} s {'late' if lag > 0 else 'early'}" in str(told)
    assert not told.is_of_frames
