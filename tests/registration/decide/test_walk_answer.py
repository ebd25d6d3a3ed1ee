# SPDX-License-Identifier: BSD-3-Clause
"""A walk's pose, judged at both sides of each limit and said in the surveys' frames."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.transform import RigidTransform

from hand_made import prepared_map, some_field
from magmatch.geometry import random_transform
from magmatch.registration.decide.probability import shares, walk_probability
from magmatch.registration.decide.walk_answer import WalkDecisionConfig, by_line_evidence
from magmatch.registration.prepared.walk import Walk
from magmatch.registration.result import Status
from magmatch.registration.search.candidate import SearchResult
from magmatch.registration.weigh.covariance import to_survey_axes
from magmatch.registration.weigh.line_evidence import LineEvidence

RNG = np.random.default_rng(0)
LENGTH = 2.0
T_BASE, T_WALK, T_POSE = (random_transform(RNG) for _ in range(3))
POSITIONS = RNG.normal(size=(20, 3))
BASE = replace(prepared_map(some_field(1), POSITIONS), T_map_model=T_BASE)
WALK = Walk(T_WALK, POSITIONS, np.ones((20, 3)), np.ones(20), pose_sd=0.02)
SD = np.array([0.01, 0.012, 0.008, 0.05, 0.04, 0.06])
CENTER = POSITIONS.mean(axis=0)
CLEAR = LineEvidence(
    T_POSE, CENTER, np.diag(SD**2), coverage=0.75, log_evidence=60.0, residual=1.0, is_covered=np.arange(20) < 15,
    log_unrelated=-50.0,
)  # fmt: skip


def answer(*ranked, lead=np.inf):
    found = SearchResult(n_keypoints=7, n_correspondences=5)
    return by_line_evidence(BASE, WALK, found, list(ranked), LENGTH, WalkDecisionConfig(), lead)


def off_by(turn=0.0, shift=0.0, log_evidence=50.0):
    T = RigidTransform.from_translation(CENTER + np.array([shift, 0, 0])) * RigidTransform.from_exp_coords(
        [0, 0, turn, 0, 0, 0]
    )
    return replace(
        CLEAR, T_base_walk=T_POSE * T * RigidTransform.from_translation(-CENTER), log_evidence=log_evidence
    )


@pytest.mark.parametrize(
    ("just", "beyond", "status"),
    [
        ({"coverage": 0.3}, {"coverage": 0.299}, Status.NO_OVERLAP),
        ({"coverage": 0.3, "log_evidence": 40.0}, {"coverage": 0.59, "log_evidence": 39.9}, Status.NO_OVERLAP),
        ({"coverage": 0.6, "log_evidence": 20.0}, {"coverage": 0.599, "log_evidence": 20.0}, Status.NO_OVERLAP),
        ({"residual": 2.0}, {"residual": 2.001}, Status.INCONSISTENT),
        ({"log_evidence": 4.0}, {"log_evidence": 3.99}, Status.INCONSISTENT),
        ({"lead": 8.0}, {"lead": 7.99}, Status.AMBIGUOUS),
        ({"k": 0, "sd": 0.0299}, {"k": 0, "sd": 0.0301}, Status.DEGENERATE),
        ({"k": 4, "sd": 0.2399}, {"k": 4, "sd": 0.2401}, Status.DEGENERATE),
    ],
)
def test_each_limit_refuses_on_its_own_side_alone(just, beyond, status):
    def status_of(lead=np.inf, k=None, sd=0.0, **changes):
        C = CLEAR.covariance.copy()
        if k is not None:
            C[k, k] = sd**2
        return answer(replace(CLEAR, covariance=C, **changes), lead=lead).status

    assert status_of(**just) is Status.ACCEPTED
    assert status_of(**beyond) is status


def test_an_accepted_pose_is_said_between_the_surveys_own_frames():
    result = answer(CLEAR)
    assert result.status is Status.ACCEPTED
    expected = T_BASE * T_POSE * T_WALK.inv()
    np.testing.assert_allclose(result.T_base_target.as_matrix(), expected.as_matrix(), atol=1e-12)
    whole = np.diag(SD**2 + [0, 0, 0, 0.02**2, 0.02**2, 0.02**2])
    np.testing.assert_allclose(result.covariance, to_survey_axes(whole, CENTER, T_WALK), atol=1e-12)
    np.testing.assert_allclose(result.links.target, T_WALK.apply(POSITIONS[:15]), atol=1e-12)
    np.testing.assert_allclose(result.links.base, T_BASE.apply(T_POSE.apply(POSITIONS[:15])), atol=1e-12)
    assert result.probability == pytest.approx(walk_probability(60.0, 1.0, 0.75))
    assert (result.overlap, result.residual, result.n_inliers) == (0.75, 1.0, 15)
    assert (result.n_keypoints, result.n_correspondences) == (7, 5)
    assert result.evidence == {"log_odds": 60.0, "lead": None}
    assert result.alternatives == ()


def test_a_refusal_shows_what_was_considered_best_first_and_shares_the_probability():
    rivals = off_by(turn=1.0, log_evidence=55.0), off_by(shift=5.0, log_evidence=30.0)
    result = answer(CLEAR, *rivals)
    assert result.status is Status.AMBIGUOUS
    assert result.T_base_target is None
    assert result.covariance is None
    assert result.evidence["lead"] == pytest.approx(5.0)
    assert [a.log_odds for a in result.alternatives] == [60.0, 55.0, 30.0]
    expected = np.multiply(walk_probability(60.0, 1.0, 0.75), shares([60.0, 55.0, 30.0]))
    np.testing.assert_allclose([a.probability for a in result.alternatives], expected)
    assert result.probability == pytest.approx(expected[0])
    np.testing.assert_allclose(
        result.alternatives[1].T_base_target.as_matrix(),
        (T_BASE * rivals[0].T_base_walk * T_WALK.inv()).as_matrix(),
        atol=1e-12,
    )


def test_poses_near_the_best_are_no_rivals_and_another_map_is_one():
    near = off_by(turn=0.139, shift=0.0, log_evidence=59.0), off_by(shift=0.54 * LENGTH, log_evidence=58.0)
    assert answer(CLEAR, *near).is_accepted
    assert answer(CLEAR, *near).evidence["lead"] is None
    for rival in (off_by(turn=0.141, log_evidence=59.0), off_by(shift=0.56 * LENGTH, log_evidence=59.0)):
        assert answer(CLEAR, rival).status is Status.AMBIGUOUS
    elsewhere = answer(CLEAR, lead=20.0)
    assert elsewhere.evidence["lead"] == 20.0
    assert elsewhere.probability == pytest.approx(walk_probability(60.0, 1.0, 0.75) * shares([60.0, 40.0])[0])


def test_no_pose_at_all_is_a_result():
    assert answer().status is Status.UNINFORMATIVE
    assert answer().n_keypoints == 7
