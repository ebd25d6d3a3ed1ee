# SPDX-License-Identifier: BSD-3-Clause
"""From a decision to the result: in the surveys' own frames, with what was considered beside the best."""

import numpy as np
import pytest
from scipy.spatial.transform import RigidTransform

from hand_made import WeighedPose
from magmatch.estimation.posterior import answers_of, posterior_of
from magmatch.geometry import random_transform
from magmatch.registration.decide.answer import state_answer
from magmatch.registration.decide.decision import Verdict
from magmatch.registration.decide.estimate import Estimate
from magmatch.registration.decide.support import Support
from magmatch.registration.result import Links, Status

RNG = np.random.default_rng(0)
T_STATED = random_transform(RNG)
CENTER = np.array([3.0, -2.0, 1.0])
C = np.diag(np.square([0.01, 0.012, 0.008, 0.05, 0.04, 0.06]))
SUPPORT = Support(
    residual=1.1,
    n_inliers=38,
    links=Links(np.zeros((2, 3)), np.ones((2, 3))),
    sensor={"scale": 1.01},
    fitness=0.02,
    statistics={"agreeing_share": 0.95},
)
MAX_SD = (0.1, 0.05)
POSES = [
    WeighedPose(RigidTransform.from_translation([5.0 * k, 0, 0]), log_evidence=e, misfit=m)
    for k, (e, m) in enumerate([(100.0, 1.05), (90.0, 1.0), (20.0, 0.9)])
]


def answer(status, poses=POSES, estimate=None, elsewhere=-np.inf, support=SUPPORT):
    posterior = posterior_of(answers_of(poses, (1.0, 0.5)), 1.0, elsewhere)
    estimate = estimate or Estimate(T_STATED, CENTER, C)
    between = [h.T_base_target for h in posterior.poses]
    verdict = Verdict(status, "so it is")
    return state_answer(verdict, posterior, between, estimate, support, MAX_SD), posterior


def test_an_accepted_pose_is_stated_as_it_was_estimated_and_alone():
    result, posterior = answer(Status.ACCEPTED, POSES[:1])
    np.testing.assert_array_equal(result.T_base_target.as_matrix(), T_STATED.as_matrix())
    np.testing.assert_allclose(result.covariance, Estimate(T_STATED, CENTER, C).covariance_about_origin, atol=1e-15)
    assert (result.status, result.reason) == (Status.ACCEPTED, "so it is")
    assert result.probability == posterior.best
    assert result.alternatives == ()
    assert (result.overlap, result.residual, result.fitness, result.n_inliers) == (0.9, 1.1, 0.02, 38)
    assert (result.sensor, result.links) == (SUPPORT.sensor, SUPPORT.links)


@pytest.mark.parametrize("status", [s for s in Status if s is not Status.ACCEPTED])
def test_a_refusal_shows_what_was_considered_best_first_and_the_mass_adds_to_one(status):
    result, posterior = answer(status, elsewhere=12.0)
    assert (result.T_base_target, result.covariance) == (None, None)
    assert [a.log_odds for a in result.alternatives] == [h.log_evidence for h in posterior.poses]
    assert tuple(a.probability for a in result.alternatives) == posterior.probabilities
    # The best as it is stated, perhaps refined once more; the others as they were weighed.
    expected = [T_STATED, *(h.T_base_target for h in posterior.poses[1:])]
    for alternative, T in zip(result.alternatives, expected, strict=True):
        np.testing.assert_array_equal(alternative.T_base_target.as_matrix(), T.as_matrix())
    assert result.probability == result.alternatives[0].probability
    said = result.evidence
    assert result.probability + said["probability_elsewhere"] + said["probability_unrelated"] == pytest.approx(1)
    rival = max(*posterior.probabilities[1:], posterior.elsewhere)
    assert said["lead"] == pytest.approx(np.log(posterior.best / rival))
    assert said["probability_elsewhere"] == posterior.rivals
