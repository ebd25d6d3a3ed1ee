# SPDX-License-Identifier: BSD-3-Clause
"""Hard iron that turns with its carrier is told from the field that stays."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

import magmatch as mm
from drifting import Place, drifting_walk, trajectory_error
from magmatch.data.survey import Survey
from magmatch.field.hyperparameters import Hyperparameters
from magmatch.field.sensor_biases import without_bias
from magmatch.slam.config import SlamConfig
from magmatch.slam.sensor_bias import in_one_calibration, sensor_bias

CONFIG = SlamConfig()
NUMBERS = Hyperparameters(1.0, 3e-6, 3e-7, 0.3, 100.0)


@pytest.mark.parametrize("seed", range(3))
def test_a_bias_in_the_plane_that_headings_span_is_recovered(seed):
    true = np.random.default_rng(seed).normal(0, 4e-6, 3)
    log, _ = drifting_walk(Place(seed), seed, bias=true)
    bias, sd = sensor_bias(log, NUMBERS, CONFIG)
    assert (sd[:2] < 1e-6).all()
    assert (np.abs(bias - true)[:2] < 4 * sd[:2]).all()
    # Upright all the way, nothing tells the vertical from the place's own.
    assert sd[2] > 5e-6
    assert abs(bias[2]) < 1e-6


def test_odometry_that_turns_by_and_by_is_not_taken_for_a_bias():
    true, squares = np.array([5e-6, -3e-6, 0.0]), []
    for seed in range(10):
        log, _ = drifting_walk(Place(seed), seed, bias=true)
        bias, sd = sensor_bias(log, NUMBERS, CONFIG)
        squares.append((((bias - true) / sd)[:2] ** 2).mean())
    # Ten walks on two axes: of a fair statement it is within 0.4 and 1.8 in 99 of 100 draws, and was 4.5 once.
    assert 0.4 < np.mean(squares) < 1.8


@pytest.mark.parametrize("seed", range(3))
def test_a_phone_that_swings_with_each_step_does_not_know_the_vertical(seed):
    # Its attitude follows four fifths of the swing; what is missed turns Earth's field, and is no bias.
    true = np.random.default_rng(seed).normal(0, 4e-6, 3)
    log, _ = drifting_walk(Place(seed), seed)
    swing = np.radians(5) * np.sin(2.2 * np.arange(len(log)))[:, None] * [0.0, 1.0, 0.0]
    seen = (log.orientations * Rotation.from_rotvec(swing)).inv().apply(log.field) + true
    orientations = log.orientations * Rotation.from_rotvec(0.8 * swing)
    bias, sd = sensor_bias(replace(log, field=orientations.apply(seen), orientations=orientations), NUMBERS, CONFIG)
    assert (np.abs(bias - true)[:2] < 4 * sd[:2]).all()
    assert sd[2] > 5e-6
    assert abs(bias[2]) < 1e-6


@pytest.mark.parametrize("turn", [[0, 0, np.pi / 2], [np.pi, 0, 0], [0.5, -0.3, 1.0]])
def test_the_bias_follows_the_carriers_axes(turn):
    log, _ = drifting_walk(Place(2), 1, bias=(3e-6, 0.0, 0.0))
    bias, _ = sensor_bias(log, NUMBERS, CONFIG)
    turned = Rotation.from_rotvec(turn)
    other, _ = sensor_bias(replace(log, orientations=log.orientations * turned), NUMBERS, CONFIG)
    np.testing.assert_allclose(turned.apply(other), bias, atol=1e-9)


def test_a_robot_that_turns_in_place_learns_its_bias_there():
    log, _ = drifting_walk(Place(2), 1, laps=0.5)
    n, true = 60, np.array([3e-6, -2e-6, 0.0])
    spin = Rotation.from_rotvec(np.linspace(0, 2 * np.pi, n)[:, None] * [0.0, 0.0, 1.0]) * log.orientations[-1]
    positions, field = (np.concatenate([v, np.repeat(v[-1:], n, axis=0)]) for v in (log.positions, log.field))
    turned = Rotation.concatenate([log.orientations, spin])
    spun = Survey(positions, field + turned.apply(true), 0.1 * np.arange(len(turned)), turned, name="spun.csv")
    bias, sd = sensor_bias(spun, NUMBERS, CONFIG)
    assert (np.abs(bias - true)[:2] < 4 * sd[:2]).all()


def test_without_orientations_there_is_no_bias():
    log, _ = drifting_walk(Place(2), 1)
    bare = replace(log, orientations=None)
    bias, sd = sensor_bias(bare, NUMBERS, CONFIG)
    assert not bias.any()
    assert not sd.any()
    assert without_bias(bare, bias) is bare


def recalibrated(log, row, step):
    """The log of a phone whose calibration jumps at a row by a step in its own axes."""
    steps = np.where(np.arange(len(log))[:, None] < row, 0.0, step)
    return replace(log, field=log.field + log.orientations.apply(steps))


@pytest.mark.parametrize(("row", "step"), [(60, [40e-6, 0.0, -20e-6]), (300, [-3e-6, 3e-6, 3e-6])])
def test_a_phone_that_recalibrates_itself_is_taken_as_it_was_for_the_longest_time(row, step):
    log, _ = drifting_walk(Place(1), 1)
    found = in_one_calibration(recalibrated(log, row, step))
    moved = log.orientations.inv().apply(found.field - log.field)
    # All as before or all as after the jump, but for how well a jump is measured between readings 10 cm apart.
    np.testing.assert_allclose(
        moved, np.tile(step if row < len(log) / 2 else np.zeros(3), (len(log), 1)), atol=1.5e-6
    )
    assert in_one_calibration(log) is log
    # The first sample's calibration, if that is asked for.
    first = in_one_calibration(recalibrated(log, row, step), 0)
    np.testing.assert_allclose(first.field[:row], log.field[:row], atol=1e-15)


def test_slam_takes_the_jump_out_and_says_when_it_was():
    log, truth = drifting_walk(Place(1), 1)
    session = mm.slam(recalibrated(log, 200, [5e-6, -2e-6, 2e-6]))
    assert trajectory_error(truth, session.trajectories[0].positions) < 0.3 * trajectory_error(truth, log.positions)
    (said,) = session.result().odometry["logs"]["walk"]["recalibrations"]
    assert said["t"] == log.times[200]
    np.testing.assert_allclose(said["step"], [5e-6, -2e-6, 2e-6], atol=1.5e-6)


def test_a_turn_that_the_attitude_missed_is_no_recalibration():
    log, _ = drifting_walk(Place(1), 1)
    missed = Rotation.from_rotvec(np.where(np.arange(len(log))[:, None] < 200, 0.0, [0.0, 0.0, np.radians(40)]))
    turned = replace(log, field=missed.apply(log.field), orientations=missed * log.orientations)
    assert in_one_calibration(turned) is turned
