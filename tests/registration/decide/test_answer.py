# SPDX-License-Identifier: BSD-3-Clause
"""From judged poses to the result: in the surveys' own frames, with what was considered beside the best."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.transform import RigidTransform

from hand_made import box, prepared_map, some_field, turn_about
from magmatch.geometry import random_transform, rotation_matrix
from magmatch.registration.decide.answer import by_evidence, covariance_of, refined
from magmatch.registration.decide.decision import DecisionConfig
from magmatch.registration.decide.probability import pose_probability, shares
from magmatch.registration.refine.refinement import RefinedPose, ResidualBlock
from magmatch.registration.refine.sensors import SensorConfig, identical_sensors
from magmatch.registration.result import Status
from magmatch.registration.search.candidate import SearchResult
from magmatch.registration.weigh.covariance import to_survey_axes
from magmatch.registration.weigh.evidence import PoseEvidence

RNG = np.random.default_rng(0)
CONFIG = DecisionConfig()
FIELD = some_field(3, bend=0.0)
T_BASE, T_TARGET = random_transform(RNG), random_transform(RNG)
BASE = replace(prepared_map(FIELD, box(RNG, 200, (2.6, 2.2, 1.4)), length=0.8), T_map_model=T_BASE)
TARGET = replace(prepared_map(FIELD, box(RNG, 100), length=0.6), T_map_model=T_TARGET)
CENTER = TARGET.samples.mean(axis=0)
T_POSE = turn_about(CENTER, np.array([0.02, 0.01, -0.02, 0.05, 0.02, 0.03]))
SD = np.array([0.01, 0.012, 0.008, 0.05, 0.04, 0.06])
FOUND = SearchResult(n_keypoints=7, n_correspondences=5)


def judged(log_evidence=100.0, xi=None, mode="none", **changes):
    """A pose off by a perturbation, with one block of ten samples, half of them explained."""
    level = -1 if mode == "none" else 3
    sensor = identical_sensors(SensorConfig(mode=mode), level)
    k = 6 + sensor.n_parameters
    r2 = np.where(np.arange(10) % 2, 11.9, 12.1)
    block = ResidualBlock(np.eye(k), np.eye(k), np.zeros((10, k)), TARGET.samples[:10], r2, np.diag(np.full(k, 0.01)))
    T = T_POSE * turn_about(CENTER, np.zeros(6) if xi is None else np.asarray(xi))
    sd = np.full(sensor.n_parameters, 1e-12 if mode == "none" else 1e-6)
    pose = RefinedPose(T, CENTER, sensor, sd, np.zeros((6, 6)), (block,))
    best = PoseEvidence(pose, np.diag(SD**2), 0.9, 40, 38, log_evidence, 1e-3, 1.1, 0.6)
    return replace(best, **changes)


def answer(*ranked, lead=np.inf, decoys=None):
    return by_evidence(BASE, TARGET, FOUND, list(ranked), CONFIG, lead, decoys)


def in_surveys(e):
    return (T_BASE * e.pose.T_base_target * T_TARGET.inv()).as_matrix()


def test_an_accepted_pose_is_said_between_the_surveys_own_frames():
    best = judged()
    result = answer(best, decoys=30.0)
    assert result.status is Status.ACCEPTED
    np.testing.assert_allclose(result.T_base_target.as_matrix(), in_surveys(best), atol=1e-12)
    whole = to_survey_axes(best.whole_covariance, CENTER, T_TARGET)
    np.testing.assert_allclose(result.covariance, whole, atol=1e-12)
    np.testing.assert_allclose(covariance_of(best, TARGET), whole, atol=1e-12)
    assert covariance_of(replace(best, covariance=None), TARGET) is None
    assert result.probability == pytest.approx(pose_probability(100.0, 30.0, 0.6, 0.95))
    assert (result.overlap, result.residual, result.n_inliers, result.n_keypoints) == (0.9, 1.1, 38, 7)
    assert result.evidence == {
        "log_odds": 100.0, "lead": None, "decoy_log_odds": 30.0, "misfit": 0.6, "unexplained": 1e-3,
        "agreeing_share": 0.95, "n_informative": 40.0, "unchanged": 1.0,
    }  # fmt: skip
    assert (result.alternatives, result.degenerate_directions, result.sensor) == ((), (), None)


def test_links_join_the_samples_that_the_base_explains():
    result = answer(judged())
    explained = TARGET.samples[1:10:2]
    np.testing.assert_allclose(result.links.target, T_TARGET.apply(explained), atol=1e-12)
    np.testing.assert_allclose(result.links.base, T_BASE.apply(T_POSE.apply(explained)), atol=1e-12)
    alone = judged()
    assert len(answer(replace(alone, pose=replace(alone.pose, blocks=()))).links.target) == 0


def test_fitness_is_that_of_the_aligned_vectors():
    T = turn_about(CENTER, np.array([0.0, 0.0, 0.4, 0.0, 0.0, 0.0]))
    turned = judged()
    turned = replace(turned, pose=replace(turned.pose, T_base_target=T))
    b = TARGET.sample_field @ rotation_matrix(T).T
    seen = FIELD.evaluate(T.apply(TARGET.samples)).field
    product = np.linalg.norm(b, axis=1) * np.linalg.norm(seen, axis=1)
    expected = np.linalg.norm(np.cross(b, seen), axis=1).sum() / product.sum()
    assert answer(turned).fitness == pytest.approx(expected, rel=1e-6)
    away = replace(turned, pose=replace(turned.pose, T_base_target=RigidTransform.from_translation([30, 0, 0])))
    assert answer(away).fitness is None


def test_a_refusal_shows_what_was_considered_and_shares_the_probability():
    ranked = judged(), judged(90.0, [0, 0, 1.0, 0, 0, 0]), judged(20.0, [0, 0, 0, 2.0, 0, 0])
    result = answer(*ranked, lead=95.0, decoys=30.0)
    assert result.status is Status.AMBIGUOUS
    assert result.T_base_target is None
    assert result.covariance is None
    assert result.evidence["lead"] == pytest.approx(10.0)
    expected = np.multiply(pose_probability(100.0, 30.0, 0.6, 0.95), shares([100.0, 90.0, 20.0, 5.0]))
    np.testing.assert_allclose([a.probability for a in result.alternatives], expected[:3])
    assert [a.log_odds for a in result.alternatives] == [100.0, 90.0, 20.0]
    for alternative, e in zip(result.alternatives, ranked, strict=True):
        np.testing.assert_allclose(alternative.T_base_target.as_matrix(), in_surveys(e), atol=1e-12)
    assert result.probability == pytest.approx(expected[0])


def test_poses_near_the_best_are_no_rivals():
    # The shorter correlation length of the two counts.
    near = judged(99.0, [0, 0, 0.139, 0, 0, 0]), judged(98.0, [0, 0, 0, 0.41, 0, 0])
    assert answer(judged(), *near).is_accepted
    assert answer(judged(), judged(99.0, [0, 0, 0.141, 0, 0, 0])).status is Status.AMBIGUOUS
    assert answer(judged(), judged(99.0, [0, 0, 0, 0.43, 0, 0])).status is Status.AMBIGUOUS
    assert answer(judged(), lead=49.0).status is Status.AMBIGUOUS


def test_directions_are_free_beyond_the_limits_in_units_of_the_shorter_length():
    just, beyond = (
        judged(covariance=np.diag([0.01**2] * 3 + [(f * 0.3 * 0.6) ** 2, 1e-4, 1e-4])) for f in (0.99, 1.01)
    )
    assert answer(just).is_accepted
    result = answer(beyond)
    assert result.status is Status.DEGENERATE
    assert len(result.degenerate_directions) == 1
    turned = judged(covariance=np.diag([0.061**2, 1e-6, 1e-6, 1e-4, 1e-4, 1e-4]))
    assert answer(turned).status is Status.DEGENERATE
    assert answer(judged(covariance=None)).status is Status.DEGENERATE


def test_words_name_the_axes_of_the_base_survey():
    R = T_BASE.rotation.as_matrix() @ T_POSE.rotation.as_matrix()
    # In the target's model axes: the base survey's z.
    along = R.T @ [0, 0, 1]
    C = np.zeros((6, 6))
    C[:3, :3], C[3:, 3:] = 1e-6 * np.eye(3), 1e-6 * np.eye(3) + np.outer(along, along)
    (free,) = answer(judged(covariance=C)).degenerate_directions
    assert free.words == "sliding along base z"


def test_the_sensors_difference_is_said_in_the_targets_survey_axes():
    best = judged(mode="full")
    D = np.array([[0.02, 0.01, 0.0], [0.0, -0.01, 0.03], [0.01, 0.0, 0.005]])
    sensor = best.pose.sensor.stepped(np.concatenate([[1e-6, 2e-6, -1e-6], D.ravel()]))
    said = answer(replace(best, pose=replace(best.pose, sensor=sensor))).sensor
    R = T_TARGET.rotation.as_matrix()
    np.testing.assert_allclose(said["bias"], R @ [1e-6, 2e-6, -1e-6], atol=1e-15)
    np.testing.assert_allclose(said["gain"], R @ (np.eye(3) + D) @ R.T, atol=1e-12)
    assert said["scale"] == pytest.approx(1 + np.trace(D) / 3)
    assert said["prior_sd"] == [1e-6] * 12


def test_a_further_refinement_takes_the_place_of_the_pose_and_is_free_or_accepted():
    first = answer(judged(), decoys=30.0)
    better = judged(xi=[0.01, 0, 0, 0.02, 0, 0], residual=0.9)
    accepted = refined(first, BASE, TARGET, better, CONFIG)
    np.testing.assert_allclose(accepted.T_base_target.as_matrix(), in_surveys(better), atol=1e-12)
    assert (accepted.status, accepted.residual, accepted.probability) == (Status.ACCEPTED, 0.9, first.probability)
    np.testing.assert_allclose(accepted.covariance, covariance_of(better, TARGET))
    free = refined(first, BASE, TARGET, replace(better, covariance=np.eye(6)), CONFIG)
    assert free.status is Status.DEGENERATE
    assert (free.T_base_target, free.covariance, len(free.degenerate_directions)) == (None, None, 6)
    np.testing.assert_allclose(free.alternatives[0].T_base_target.as_matrix(), in_surveys(better), atol=1e-12)
    assert free.alternatives[0].log_odds == 100.0


def test_no_pose_at_all_is_a_result():
    assert answer().status is Status.UNINFORMATIVE
    assert answer().n_keypoints == 7
