# SPDX-License-Identifier: BSD-3-Clause
"""From a decision to the result in the surveys' own frames."""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from scipy.spatial.transform import RigidTransform

from magmatch.estimation.posterior import Hypothesis, Posterior
from magmatch.registration.decide.decision import Verdict
from magmatch.registration.decide.estimate import Estimate
from magmatch.registration.decide.support import Support
from magmatch.registration.result import Alternative, RegistrationResult, Status


def state_answer(
    verdict: Verdict,
    posterior: Posterior[Hypothesis],
    poses: Sequence[RigidTransform],
    estimate: Estimate,
    support: Support,
    max_sd: tuple[float, float],
) -> RegistrationResult:
    """State the decision as a result, of at least one pose; what the search counted is left to be filled in.

    ``poses`` are the posterior's between the surveys' frames; estimate and support are of the first of them, as it is
    stated; ``max_sd`` (m, rad) are the largest standard deviations asked for.
    """
    best, is_accepted = posterior.poses[0], verdict.status is Status.ACCEPTED
    first, *others = (
        Alternative(T, probability, log_odds=h.log_evidence)
        for T, probability, h in zip(
            [estimate.T_base_target, *poses[1:]], posterior.probabilities, posterior.poses, strict=True
        )
    )
    shift, turn = estimate.worst_sd
    if np.isfinite([turn, shift]).all():
        first = replace(first, sd=(turn, shift))
    return RegistrationResult(
        status=verdict.status,
        reason=verdict.reason,
        T_base_target=estimate.T_base_target if is_accepted else None,
        covariance=estimate.covariance_about_origin if is_accepted else None,
        probability=posterior.best,
        overlap=best.overlap,
        # A unique answer has no alternatives; a refusal shows what was considered, best first.
        alternatives=() if is_accepted else (first, *others),
        evidence={
            "log_odds": best.log_evidence,
            "effective": posterior.answers[0].effective,
            "lead": posterior.lead,
            "misfit": best.misfit if np.isfinite(best.misfit) else None,
            "probability_elsewhere": posterior.rivals,
            "probability_unrelated": posterior.null,
        }
        | support.statistics,
        degenerate_directions=estimate.free_directions(max_sd),
        sensor=support.sensor,
        residual=support.residual,
        fitness=support.fitness,
        n_inliers=support.n_inliers,
        links=support.links,
    )
