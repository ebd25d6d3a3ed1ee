# SPDX-License-Identifier: BSD-3-Clause
"""The published method's findings are stated as a registration's result: no covariance, no probability."""

from collections.abc import Sequence
from dataclasses import replace

from scipy.spatial.transform import RigidTransform

from magmatch.published.fitness import Fitness, FitnessConfig
from magmatch.published.register import Published
from magmatch.registration.decide.decision import Verdict
from magmatch.registration.result import Alternative, Links, RegistrationResult, Status


def answer_of(found: Published) -> RegistrationResult:
    """State the best consensus, judged by its fitness, and the others as alternatives."""
    inliers = found.inliers
    base, target = found.matches.base_rows[inliers], found.matches.target_rows[inliers]
    return replace(
        state_check([c.T_base_target for c in found.candidates], found.check, found.config.decision),
        n_inliers=int(inliers.sum()),
        n_keypoints=len(found.base) + len(found.target),
        n_correspondences=len(found.matches),
        links=Links(found.base.positions[base], found.target.positions[target]),
    )


def state_check(poses: Sequence[RigidTransform], check: Fitness | None, config: FitnessConfig) -> RegistrationResult:
    """State the first of some poses, of which there may be none, as its final check judges it."""
    verdict = verdict_of(check, config)
    is_accepted = verdict.status is Status.ACCEPTED
    return RegistrationResult(
        status=verdict.status,
        reason=verdict.reason,
        T_base_target=poses[0] if is_accepted else None,
        overlap=check.overlap if check else 0.0,
        alternatives=() if is_accepted else tuple(Alternative(T) for T in poses),
        fitness=check.value if check else None,
    )


def verdict_of(check: Fitness | None, config: FitnessConfig) -> Verdict:
    """Say in words what the final check says (None: no pose)."""
    if check is None:
        return Verdict(Status.UNINFORMATIVE, "too few matching keypoints for a pose; survey closer to iron")
    if check.overlap < config.min_overlap:
        return Verdict(Status.NO_OVERLAP, f"only {check.overlap:.0%} of the target falls inside the base map")
    value, limit, name = check.value, config.max_fitness, "fitness"
    if config.max_cross is not None:
        value, limit, name = check.cross, config.max_cross, "mean cross product, T^2,"
    if check.passes(config):
        return Verdict(Status.ACCEPTED, f"{name} {value:.3g} is below {limit:.3g}")
    return Verdict(Status.INCONSISTENT, f"{name} {value:.3g} is above {limit:.3g}: aligned vectors do not agree")
