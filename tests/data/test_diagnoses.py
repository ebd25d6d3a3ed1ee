# SPDX-License-Identifier: BSD-3-Clause
"""Each mistake in a survey's frames and units is told by its kind; a survey without any is told of none."""

import logging
import re
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial.transform import RigidTransform, Rotation

from magmatch.data.diagnoses import AXES, diagnose, inclination_deg, of_verticals, warn
from magmatch.data.recordings import load_recordings
from magmatch.data.survey import Survey

EARTH = np.array([3e-6, 18e-6, -45e-6])


def walk(seed=0, wild=4e-6, n=500):
    """Round a hall, twice, by someone who holds a phone that leans and sways; the field varies over a metre."""
    rng = np.random.default_rng(seed)
    t = np.linspace(0, 4 * np.pi, n)
    positions = np.column_stack([12 * np.cos(t), 6 * np.sin(t) + 2 * np.sin(3 * t), 0.03 * np.sin(9 * t)])
    phases, waves = rng.uniform(0, 2 * np.pi, (3, 20)), rng.normal(0, 1.0, (20, 3))
    anomalies = np.column_stack([np.sin(positions @ waves.T + phase).sum(axis=1) for phase in phases])
    steps = np.gradient(positions, axis=0)
    heading = np.arctan2(steps[:, 1], steps[:, 0])
    lean = np.column_stack([0.3 + 0.05 * np.sin(7 * t), 0.05 * np.cos(5 * t)])
    q = Rotation.from_euler("z", heading[:, None]) * Rotation.from_euler("xy", lean)
    return Survey(positions, EARTH + wild * anomalies / np.sqrt(10), 0.1 * np.arange(n), q, name="walk.csv")


def held(survey, q):
    """The survey with other orientations, by which the sensor's readings were turned."""
    return replace(survey, orientations=q, field=q.apply(survey.orientations.apply(survey.field, inverse=True)))


def rolled(q, places):
    return Rotation.from_quat(np.roll(q.as_quat(), places, axis=1))


def drifting(survey):
    """Orientations whose heading turns twice too often."""
    turns = Rotation.from_euler("z", np.linspace(0, 4 * np.pi, len(survey))[:, None])
    return held(survey, turns * survey.orientations)


MISTAKES = {
    "readings in the sensor's axes": (
        lambda s: replace(s, field=s.orientations.apply(s.field, inverse=True)),
        "field frame",
        "--field-frame sensor",
    ),
    "turned twice": (
        lambda s: replace(s, field=s.orientations.apply(s.field)),
        "field frame",
        "--field-frame survey",
    ),
    "survey to sensor": (lambda s: held(s, s.orientations.inv()), "orientations", "invert"),
    "scalar first": (lambda s: held(s, rolled(s.orientations, 1)), "orientations", "scalar"),
    "scalar last": (lambda s: held(s, rolled(s.orientations, -1)), "orientations", "scalar"),
    "heading of its own": (drifting, "heading", "spread .* offset"),
    "readings that turn, no orientations": (
        lambda s: replace(s, field=s.orientations.apply(s.field, inverse=True), orientations=None),
        "turning",
        "--field-frame sensor and give orientations",
    ),
    "nanotesla for microtesla": (lambda s: replace(s, field=1e-3 * s.field), "magnitude", "--field-unit uT"),
}


@pytest.mark.parametrize("name", MISTAKES)
@settings(deadline=None, max_examples=5)
@given(seed=st.integers(0, 10**6), wild=st.floats(0.0, 6e-6))
def test_each_mistake_is_told_by_its_kind_and_remedy(name, seed, wild):
    mistake, kind, words = MISTAKES[name]
    (found,) = diagnose(mistake(walk(seed, wild)), "nT" if kind == "magnitude" else "T")
    assert found.kind == kind
    assert re.search(words, str(found))


@settings(deadline=None, max_examples=12)
@given(seed=st.integers(0, 10**6), wild=st.floats(0.0, 8e-6), turn=st.floats(-3.1, 3.1))
def test_a_survey_as_it_should_be_is_told_of_nothing_wherever_it_lies(seed, wild, turn):
    survey = walk(seed, wild)
    assert diagnose(survey) == []
    moved = RigidTransform.from_components([40.0, -7.0, 2.0], Rotation.from_euler("z", turn))
    assert diagnose(survey.transformed(moved)) == []
    assert diagnose(replace(survey, orientations=None)) == []
    assert diagnose(replace(survey, orientations=None, times=None)) == []


def with_hard_iron(survey, microtesla, direction):
    """The survey by a sensor that adds a constant in its own axes."""
    iron = Rotation.from_euler("zy", direction).apply([1e-6 * microtesla, 0, 0])
    return replace(survey, field=survey.field + survey.orientations.apply(iron))


DIRECTIONS = st.tuples(st.floats(-3.1, 3.1), st.floats(-1.5, 1.5))


@settings(deadline=None, max_examples=12)
@given(seed=st.integers(0, 10**6), microtesla=st.floats(0, 100), direction=DIRECTIONS)
def test_hard_iron_is_no_wrong_frame(seed, microtesla, direction):
    assert [one.kind for one in diagnose(with_hard_iron(walk(seed), microtesla, direction)) if one.is_of_frames] == []


@settings(deadline=None, max_examples=12)
@given(seed=st.integers(0, 10**6), microtesla=st.floats(0, 30), direction=DIRECTIONS)
def test_hard_iron_hides_no_forgotten_frame(seed, microtesla, direction):
    wrong = MISTAKES["readings in the sensor's axes"][0](with_hard_iron(walk(seed), microtesla, direction))
    (found,) = diagnose(wrong)
    assert "--field-frame sensor" in found.remedy


def test_a_sensor_that_keeps_its_attitude_and_a_field_that_is_constant_are_told_of_nothing():
    survey = walk()
    assert diagnose(replace(survey, orientations=Rotation.identity(len(survey)))) == []
    assert diagnose(replace(survey, field=np.tile(EARTH, (len(survey), 1)))) == []


@pytest.mark.parametrize("axes", [name for name, axes in AXES.items() if axes[2, 2] != 1])
def test_orientations_in_other_axes_than_the_path_are_told(axes):
    survey = walk()
    C = Rotation.from_matrix(AXES[axes])
    (found,) = diagnose(held(survey, C * survey.orientations))
    assert found.kind == "two frames"


def test_a_turn_about_the_vertical_between_orientations_and_path_is_the_mounting_of_the_sensor():
    survey = walk()
    for axes in (axes for axes in AXES.values() if axes[2, 2] == 1):
        assert diagnose(held(survey, Rotation.from_matrix(axes) * survey.orientations)) == []


@pytest.mark.parametrize("latitude", [48.1, -33.9])
def test_a_field_in_north_east_down_is_told_where_the_latitude_is_known(latitude):
    s = replace(walk(), frame=f"east, north, up of {latitude},11.5", orientations=None)
    right = replace(s, field=s.field * [1, 1, 1 if latitude > 0 else -1])
    ned = replace(right, field=right.field[:, [1, 0, 2]] * [1, 1, -1])
    assert diagnose(right) == []
    (told,) = diagnose(ned)
    assert "--columns bx=by,by=bx,bz=-bz" in told.remedy
    assert diagnose(replace(ned, frame="survey")) == []
    assert diagnose(replace(ned, frame="east, north, up of 5.0,11.5")) == []


def test_one_warning_names_all_surveys_of_its_kind(caplog):
    wrong = MISTAKES["readings in the sensor's axes"][0](walk())
    with caplog.at_level(logging.WARNING, logger="magmatch"):
        found = warn([replace(wrong, name=f"{k}.csv") for k in range(5)])
    assert len(found) == 5
    assert all(one.is_of_frames for one in found)
    (record,) = caplog.records
    assert record.getMessage().startswith("0.csv, 1.csv, 3 others: the field vectors look like those of a sensor")


@pytest.mark.parametrize("name", ["kok", "jidling", "aalto", "cea"])
def test_recordings_are_told_of_nothing_and_their_readings_in_the_sensors_axes_are(recordings, name):
    for survey in load_recordings(name, recordings).values():
        assert diagnose(survey) == []
        if survey.orientations is not None:
            (found,) = diagnose(replace(survey, field=survey.orientations.apply(survey.field, inverse=True)))
            assert found.kind == "field frame"


@pytest.mark.parametrize("axes", [name for name in AXES if name.startswith("z") or name.endswith(", -z")])
@pytest.mark.parametrize("heading", [0.0, 2.0])
def test_two_surveys_with_z_up_in_one_alone_contradict_each_other(axes, heading):
    base, turned = walk(), walk().transformed(RigidTransform.from_rotation(Rotation.from_euler("z", heading)))
    assert of_verticals(base, turned) == []
    swapped = replace(base, field=base.field @ AXES[axes])
    told = [one for pair in ((base, swapped), (swapped, base)) for one in of_verticals(*pair)]
    assert [one.kind for one in told] == ["vertical", "vertical"]
    assert f"dips {inclination_deg(base.field.mean(axis=0)):.0f} deg below the base's" in told[0].measured
