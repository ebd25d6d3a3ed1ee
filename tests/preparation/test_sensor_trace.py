# SPDX-License-Identifier: BSD-3-Clause
"""Readings that turn with their sensor are told from those of a place; quickly, and in any frame."""

from dataclasses import replace

import numpy as np
import pytest

from magmatch.field.hyperparameters import Hyperparameters
from magmatch.field.selection.spline_hyperparameters import choose_spline_hyperparameters
from magmatch.geometry import random_transform
from magmatch.preparation.sensor_trace import MIN_EVIDENCE, offset_evidence


def evidence(survey):
    return offset_evidence(survey, choose_spline_hyperparameters(survey.positions, survey.field))


@pytest.mark.parametrize("carrier", ["hand_held", "robot"])
def test_a_raw_log_shows_its_sensor_and_a_clean_one_does_not(carrier, request):
    clean, raw, _ = request.getfixturevalue(carrier)
    assert evidence(clean) < 0
    assert evidence(raw) > 2 * MIN_EVIDENCE


@pytest.mark.parametrize("size", [2e-6, 8e-6])
def test_hard_iron_alone_is_shown_along_any_axis(hand_held, size):
    clean = hand_held[0]
    h = choose_spline_hyperparameters(clean.positions, clean.field)
    for axis in np.eye(3):
        offset = clean.orientations.apply(np.tile(size * axis, (len(clean), 1)))
        assert offset_evidence(replace(clean, field=clean.field + offset), h) > MIN_EVIDENCE


def test_offset_along_an_axis_that_never_turns_is_not_shown(robot):
    # It is one more constant field of the place.
    clean = robot[0]
    h = choose_spline_hyperparameters(clean.positions, clean.field)
    vertical = np.array([0.0, 0.0, 30e-6])
    there = replace(clean, field=clean.field + clean.orientations.apply(np.tile(vertical, (len(clean), 1))))
    assert offset_evidence(there, h) < MIN_EVIDENCE


def test_the_frame_of_the_survey_does_not_matter(hand_held):
    raw = hand_held[1]
    h = choose_spline_hyperparameters(raw.positions, raw.field)
    moved = raw.transformed(random_transform(np.random.default_rng(3)))
    assert offset_evidence(moved, h) == pytest.approx(offset_evidence(raw, h), rel=1e-6)


def test_without_orientations_nothing_is_told(hand_held):
    raw = replace(hand_held[1], orientations=None)
    assert offset_evidence(raw, choose_spline_hyperparameters(raw.positions, raw.field)) == -np.inf


def test_maps_that_would_take_too_long_are_not_asked(hand_held):
    assert offset_evidence(hand_held[1], Hyperparameters(0.5, 1e-5, 1e-6, 0.005)) == -np.inf
