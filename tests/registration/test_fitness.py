# SPDX-License-Identifier: BSD-3-Clause
"""The published check of a transform, and the decision by it."""

import numpy as np
import pytest
from scipy.spatial.transform import RigidTransform

from hand_made import exp_se3
from magmatch.geometry import random_transform
from magmatch.published.fitness import Fitness, FitnessConfig, fitness, mean_misalignment
from magmatch.registration.published_answer import state_check, verdict_of
from magmatch.registration.result import Status


@pytest.mark.parametrize(("angle_deg", "value"), [(30, 0.5), (90, 1.0), (150, 1.0), (180, 1.0)])
def test_misalignment_is_the_sine_up_to_a_right_angle_and_full_beyond(angle_deg, value):
    a = np.radians(angle_deg)
    np.testing.assert_allclose(
        mean_misalignment(np.array([[3e-5, 0, 0]]), 5e-5 * np.array([[np.cos(a), np.sin(a), 0]])), value
    )


def test_vanishing_fields_agree_with_nothing():
    assert mean_misalignment(np.zeros((3, 3)), np.zeros((3, 3))) == 1.0


def test_the_true_pose_is_fit_and_a_wrong_one_is_not(make_exact_pair):
    T = random_transform(np.random.default_rng(1))
    base, target = make_exact_pair(1, T)
    right = fitness(base, target.survey, T)
    wrong = fitness(base, target.survey, T * exp_se3(np.array([0, 0, 0.5, 0, 0, 0])))
    assert right.value < 0.02
    assert right.overlap == 1.0
    assert wrong.value > 5 * right.value


def test_partial_overlap_is_counted_and_none_is_never_fit(make_exact_pair):
    T = random_transform(np.random.default_rng(1))
    base, target = make_exact_pair(1, T)
    aside = fitness(base, target.survey, RigidTransform.from_translation([1.5, 0, 0]) * T)
    assert 0.3 < aside.overlap < 0.9
    away = fitness(base, target.survey, RigidTransform.from_translation([50, 0, 0]) * T)
    assert (away.value, away.overlap) == (1.0, 0.0)


def test_the_printed_check_is_a_mean_cross_product(make_exact_pair):
    T = random_transform(np.random.default_rng(1))
    base, target = make_exact_pair(1, T)
    check = fitness(base, target.survey, T * exp_se3(np.array([0, 0, 0.05, 0, 0, 0])))
    assert check.passes(FitnessConfig(max_cross=1.01 * check.cross))
    assert not check.passes(FitnessConfig(max_cross=0.99 * check.cross, max_fitness=9.0))


@pytest.mark.parametrize(
    ("fitness", "overlap", "status"),
    [
        (None, 0.0, Status.UNINFORMATIVE),
        (0.01, 0.0499, Status.NO_OVERLAP),
        (0.1001, 0.9, Status.INCONSISTENT),
        (0.1, 0.05, Status.ACCEPTED),
    ],
)
def test_published_rule_looks_at_fitness_and_overlap_alone(fitness, overlap, status):
    check = None if fitness is None else Fitness(fitness, overlap)
    assert verdict_of(check, FitnessConfig()).status is status


def test_the_answer_is_the_best_consensus_or_a_refusal_that_shows_all():
    rng = np.random.default_rng(0)
    poses = random_transform(rng), random_transform(rng)
    accepted, refused = (state_check(poses, Fitness(value, 0.7), FitnessConfig()) for value in (0.05, 0.5))
    assert accepted.T_base_target is poses[0]
    assert (accepted.fitness, accepted.overlap, accepted.alternatives) == (0.05, 0.7, ())
    assert refused.T_base_target is None
    assert [a.T_base_target for a in refused.alternatives] == list(poses)
