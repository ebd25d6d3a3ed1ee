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
from magmatch.registration.result import NO_LINKS, Status

RNG = np.random.default_rng(0)
T_STATED = random_transform(RNG)
CENTER = np.array([3.0, -2.0, 1.0])
SUPPORT = Support(residual=1.1, n_inliers=38, links=NO_LINKS)
POSES = [
    WeighedPose(RigidTransform.from_translation([5.0 * k, 0, 0]), log_evidence=e, misfit=m)
    for k, (e, m) in enumerate([(100.0, 1.05), (90.0, 1.0), (20.0, 0.9)])
]


def test_a_refusal_shows_what_was_considered_best_first_and_the_mass_adds_to_one():
    posterior = posterior_of(answers_of(POSES, (1.0, 0.5)), 1.0, 12.0)
    between = [h.T_base_target for h in posterior.poses]
    verdict, estimate = Verdict(Status.AMBIGUOUS, "so it is"), Estimate(T_STATED, CENTER, np.eye(6))
    result = state_answer(verdict, posterior, between, estimate, SUPPORT, (0.1, 0.05))
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
