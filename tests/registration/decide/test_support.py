# SPDX-License-Identifier: BSD-3-Clause
"""What a result states beside its pose: links, fitness, sensor and counts, in the surveys' own frames."""

from dataclasses import replace

import numpy as np
import pytest

from hand_made import box, prepared_map, some_field, turn_about
from magmatch.estimation.pose_prior import FAR2
from magmatch.geometry import random_transform
from magmatch.registration.decide.support import support_of_map
from magmatch.registration.refine.refinement import RefinedPose, ResidualBlock
from magmatch.registration.refine.sensors import SensorConfig, identical_sensors
from magmatch.registration.weigh.evidence import PoseEvidence

RNG = np.random.default_rng(0)
FIELD = some_field(3, bend=0.0)
T_BASE, T_TARGET = (random_transform(RNG) for _ in range(2))
BASE = replace(prepared_map(FIELD, box(RNG, 200, (2.6, 2.2, 1.4)), length=0.8), T_map_model=T_BASE)
TARGET = replace(prepared_map(FIELD, box(RNG, 100), length=0.6), T_map_model=T_TARGET)
CENTER = TARGET.samples.mean(axis=0)
T_POSE = turn_about(CENTER, np.array([0.02, 0.01, -0.02, 0.05, 0.02, 0.03]))
T_SURVEYS = T_BASE * T_POSE * T_TARGET.inv()


def pose_at(T=T_POSE, mode="none", n=10):
    """With one block, of which every second sample is explained."""
    sensor = identical_sensors(SensorConfig(mode=mode), -1 if mode == "none" else 1)
    k = 6 + sensor.n_parameters
    r2 = FAR2 * np.where(np.arange(n) % 2, 0.99, 1.01)
    positions = np.resize(TARGET.samples, (n, 3))
    block = ResidualBlock(np.eye(k), np.eye(k), np.zeros((n, k)), positions, r2, np.zeros((k, k)))
    sd = np.full(sensor.n_parameters, 1e-12 if mode == "none" else 1e-6)
    return RefinedPose(T, CENTER, sensor, sd, np.zeros((6, 6)), (block,))


def weighed(pose=None, **changes):
    best = PoseEvidence(pose or pose_at(), np.eye(6), 0.9, 40, 38, 100.0, 150.0, -20.0, 1.1, 0.6)
    return replace(best, **changes)


def support(best):
    return support_of_map(BASE, TARGET, best, T_SURVEYS)


def test_links_join_the_samples_that_the_base_explains():
    links = support(weighed()).links
    explained = TARGET.samples[1:10:2]
    np.testing.assert_allclose(links.target, T_TARGET.apply(explained), atol=1e-12)
    np.testing.assert_allclose(links.base, T_BASE.apply(T_POSE.apply(explained)), atol=1e-12)
    assert len(support(weighed(replace(pose_at(), blocks=()))).links.target) == 0


def test_the_sensors_difference_is_said_in_the_targets_survey_axes():
    pose = pose_at(mode="full")
    D = np.array([[0.02, 0.01, 0.0], [0.0, -0.01, 0.03], [0.01, 0.0, 0.005]])
    sensor = pose.sensor.stepped(np.concatenate([[1e-6, 2e-6, -1e-6], D.ravel()]))
    said = support(weighed(replace(pose, sensor=sensor))).sensor
    R = T_TARGET.rotation.as_matrix()
    np.testing.assert_allclose(said["bias"], R @ [1e-6, 2e-6, -1e-6], atol=1e-15)
    np.testing.assert_allclose(said["gain"], R @ (np.eye(3) + D) @ R.T, atol=1e-12)
    assert said["scale"] == pytest.approx(1 + np.trace(D) / 3)
    assert said["prior_sd"] == [1e-6] * 12
    assert support(weighed()).sensor is None
