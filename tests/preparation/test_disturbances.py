# SPDX-License-Identifier: BSD-3-Clause
"""Disturbances in a surveyed room: found where they are, nowhere else, and removed only where that was asked for."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from magmatch.errors import SurveyError
from magmatch.field.hyperparameters import Hyperparameters
from magmatch.field.selection.spline_hyperparameters import choose_spline_hyperparameters
from magmatch.preparation.config import PreparationConfig
from magmatch.preparation.disturbances import find_contradictions, find_jumps, find_saturation, find_spikes
from magmatch.preparation.prepare import prepare
from magmatch.simulation.corruption import Corruption, corrupt

STILL = {"time_offset": {"mode": "off"}, "calibration": dict.fromkeys(("soft_iron", "misalignment"), "off")}


def settings_of(**changes):
    return PreparationConfig.model_validate(STILL | changes)


@pytest.fixture(scope="module")
def disturbed(robot):
    """Metal that passed for some seconds, spikes, a stuck sensor and a current."""
    clean = robot[0]
    rng = np.random.default_rng(4)
    current = np.repeat(rng.uniform(0, 5, 60), 20)
    coefficient = np.array([1e-6, -0.5e-6, 0.3e-6])
    raw, _ = corrupt(clean, Corruption(current=current, current_coefficient=coefficient), rng)
    field = raw.field.copy()
    field[[100, 500, 900]] += 40e-6
    passing = (clean.times > 20) & (clean.times < 24)
    field[passing] += 10e-6 * np.sin((clean.times[passing] - 20) / 4 * np.pi)[:, None] * [0.7, -0.5, 0.5]
    readings = clean.orientations.apply(field, inverse=True)
    readings[700:704] = readings[700]
    survey = replace(clean, field=clean.orientations.apply(readings))
    channels = {"amps": current, "noise": rng.standard_normal(len(clean))}
    return survey, channels, coefficient


@pytest.fixture(scope="module")
def flagged(disturbed):
    survey, channels, _ = disturbed
    return prepare(survey, settings_of(), channels=channels)


@pytest.fixture(scope="module")
def removed(disturbed):
    survey, channels, _ = disturbed
    modes = dict.fromkeys(("spikes", "drop_outs", "saturation", "moving_metal"), "remove")
    return prepare(survey, settings_of(disturbances=modes, currents={"mode": "remove"}), channels=channels)


def test_a_current_is_reported_with_its_coefficient_and_no_sample_is_removed(flagged, disturbed):
    step = flagged[1]["channel amps"]
    assert step.outcome == "flagged"
    np.testing.assert_allclose(step.figures["estimate"][:2], disturbed[2][:2], rtol=0, atol=0.2e-6)
    assert len(flagged[0]) == len(disturbed[0])
    assert flagged[1]["spikes"].words.endswith("kept")


def test_a_current_is_taken_off_where_asked_for(removed, disturbed):
    step = removed[1]["channel amps"]
    assert step.outcome == "applied"
    assert step.after < step.before
    np.testing.assert_allclose(step.figures["estimate"], disturbed[2], rtol=0, atol=0.2e-6)


def test_spikes_are_found_and_removed(removed):
    assert removed[1]["spikes"].figures["runs"] == [[5.0, 5.0], [25.0, 25.0], [45.0, 45.0]]
    assert not np.isin([5.0, 25.0, 45.0], removed[0].times).any()
    assert removed[1]["spikes"].words.endswith("left out")


def test_metal_that_passed_is_found_where_it_passed(removed):
    found = removed[1]["moving metal"].figures["runs"]
    assert found
    assert all(19.5 < first <= last < 24.5 for first, last in found)


def test_nothing_left_is_an_error_in_words(robot):
    off = dict.fromkeys(("spikes", "moving_metal", "drop_outs"), "off") | {"saturation": "remove"}
    few = robot[0].subset(np.arange(60))
    # One component or another at the end of its range.
    readings = 1e-6 * np.random.default_rng(0).uniform(-1, 1, (60, 3))
    readings[:30, 0] = readings[30:, 1] = 50e-6
    # A sensor that never turns, so that equal readings stay equal to the bit.
    stuck = replace(few, field=readings, orientations=Rotation.identity(60))
    with pytest.raises(SurveyError, match="nothing is left"):
        prepare(stuck, settings_of(disturbances=off))


def test_poses_that_are_a_little_off_beside_steel_are_no_metal_that_moved(hand_held):
    clean = hand_held[0]
    drift = 0.05 * np.sin(np.arange(len(clean))[:, None] / [60, 77, 91])
    points = clean.positions + drift
    found = find_contradictions(points, clean.field, choose_spline_hyperparameters(points, clean.field))
    assert found.mean() < 0.05


@pytest.fixture(scope="module")
def laps():
    """Four laps of a circle, poses a little off, past metal on the second; where; and numbers of a map."""
    rng, turn = np.random.default_rng(2), np.linspace(0, 8 * np.pi, 800)
    x = 0.8 * np.c_[np.cos(turn), np.sin(turn), 0.2 * np.sin(3 * turn)]
    off = x + 0.01 * rng.normal(size=x.shape)
    b = 3e-6 * np.c_[np.sin(3 * off[:, 1]), np.sin(3 * off[:, 0]), np.cos(3 * off[:, 1]) + np.cos(4 * off[:, 0])]
    b += [2e-5, 0, -4e-5] + 0.2e-6 * rng.normal(size=x.shape)
    passing = (np.arange(800) >= 300) & (np.arange(800) < 340)
    b[passing] += [8e-6, -6e-6, 7e-6]
    return x, b, passing, Hyperparameters(0.5, 3e-6, 0.2e-6, 0.25, 100.0)


@pytest.mark.parametrize(("length", "field"), [(1.0, 1.0), (100.0, 1.0), (1.0, 1e3)])
def test_what_passed_on_one_lap_is_found_in_any_unit_and_nothing_else(laps, length, field):
    x, b, passing, h = laps
    scaled = replace(
        h, lengthscale=length * h.lengthscale, spacing=length * h.spacing, signal_sd=field * h.signal_sd,
        noise_sd=field * h.noise_sd,
    )  # fmt: skip
    found = find_contradictions(length * x, field * b, scaled)
    assert found[passing].mean() > 0.8
    assert found[~passing].mean() < 0.02
    spiked = field * b
    spiked[[50, 600]] += field * np.array([[2e-5, 0, 0], [0, -2e-5, 0]])
    spikes = find_spikes(length * x, spiked, scaled, 10.0, in_order=True)
    assert np.flatnonzero(spikes).tolist() == [50, 600]


@pytest.mark.parametrize(("n", "is_jump"), [(1, True), (2, True), (5, False), (6, False)])
def test_readings_that_bear_each_other_out_are_no_jump(robot, n, is_jump):
    readings = robot[0].field.copy()
    readings[500 : 500 + n] += 20e-6
    assert find_jumps(readings, 10.0)[500 + n // 2] == is_jump


def test_saturation_needs_five_readings_at_the_limit_and_more_than_at_the_next_three():
    rng = np.random.default_rng(1)
    for count in (4, 5):
        x = rng.uniform(-1, 1, (50, 3))
        x[:count, 1] = -2.0
        assert find_saturation(x).sum() == (count if count == 5 else 0)
    steps = np.concatenate([np.full(6, 3.0), np.full(3, 2.0), np.full(3, 1.5), np.arange(-5, 1, 0.1)])
    assert not find_saturation(np.tile(steps[:, None], (1, 3))).any()
