# SPDX-License-Identifier: BSD-3-Clause
"""Accept or refuse a walk's pose, and state the answer in the surveys' own frames."""

from collections.abc import Iterator

import numpy as np
from pydantic import BaseModel, ConfigDict, Field
from scipy.spatial.transform import RigidTransform

from magmatch.geometry import rotation_matrix, transform_points
from magmatch.registration.decide.decision import Verdict, odds_in_words
from magmatch.registration.decide.probability import shares, walk_probability
from magmatch.registration.decide.same_pose import is_same_pose
from magmatch.registration.prepared.prepared_map import PreparedMap
from magmatch.registration.prepared.walk import Walk
from magmatch.registration.result import Alternative, DegenerateDirection, Links, RegistrationResult, Status
from magmatch.registration.search.candidate import SearchResult
from magmatch.registration.weigh.covariance import free_directions, to_survey_axes
from magmatch.registration.weigh.line_evidence import LineEvidence

# Poses nearer than this are one answer, in correlation lengths.
SAME_PLACE = 0.55


class WalkDecisionConfig(BaseModel):
    """When a walk's pose is accepted."""

    model_config = ConfigDict(frozen=True, extra="forbid")

    # Fewest bins' share inside the base map, and how few will do where the log odds, which pay for the rest, are so.
    min_coverage: float = Field(default=0.6, ge=0, le=1)
    min_clear_coverage: float = Field(default=0.3, ge=0, le=1)
    clear_log_evidence: float = 40.0
    # Log odds that the pose must have, and by how much it must lead any pose elsewhere, nats.
    min_log_evidence: float = 4.0
    min_lead: float = 8.0
    # Largest normalised residual: beyond it the learned covariance does not describe what was measured.
    max_residual: float = Field(default=2.0, gt=0)
    # Largest standard deviation of the pose in its worst direction: rad, and in correlation lengths. Of 120 walks of
    # 5 m in CEA, 0.03 rad accepts 54 right and 4 over 3 deg, 0.035 rad 71 and 10; of 10 m both accept 119 and none.
    max_sd_rotation: float = Field(default=0.03, gt=0)
    max_sd_translation: float = Field(default=0.12, gt=0)


def by_line_evidence(
    base: PreparedMap,
    walk: Walk,
    found: SearchResult,
    ranked: list[LineEvidence],
    length: float,
    config: WalkDecisionConfig,
    lead: float = np.inf,
) -> RegistrationResult:
    """Judge weighed poses of a walk and state the answer in survey frames."""
    if not ranked:
        reason = (
            "no pose to judge: the walk is shorter than the base's correlation length, or none of its pairs is there"
        )
        return RegistrationResult(Status.UNINFORMATIVE, reason, None, n_keypoints=found.n_keypoints)
    best = ranked[0]
    rivals = _distinct(ranked, SAME_PLACE * length)[1:]
    explained = walk_probability(best.log_evidence, best.residual, best.coverage)
    odds = [best.log_evidence, *(e.log_evidence for e in rivals), best.log_evidence - lead]
    probabilities = [explained * share for share in shares(odds)]
    lead = min([lead, *(best.log_evidence - e.log_evidence for e in rivals)])
    poses = [base.T_map_model * e.T_base_walk * walk.T_survey_walk.inv() for e in (best, *rivals)]
    # The base's own stretches show how its poses drift, not how far the walk's frame is off as a whole.
    covariance = best.covariance + np.diag([0.0] * 3 + [walk.pose_sd**2] * 3)
    free = free_directions(
        best.covariance,
        best.center,
        walk.T_survey_walk,
        rotation_matrix(poses[0]),
        config.max_sd_rotation,
        config.max_sd_translation * length,
    )
    accepted = Verdict(Status.ACCEPTED, odds_in_words(best.log_evidence, lead))
    verdict = next(_refusals(best, free, lead, config), accepted)
    is_accepted = verdict.status is Status.ACCEPTED
    return RegistrationResult(
        status=verdict.status,
        reason=verdict.reason,
        T_base_target=poses[0] if is_accepted else None,
        covariance=to_survey_axes(covariance, best.center, walk.T_survey_walk) if is_accepted else None,
        probability=probabilities[0],
        overlap=best.coverage,
        alternatives=()
        if is_accepted
        else tuple(
            Alternative(T, p, log_odds=e.log_evidence)
            for T, p, e in zip(poses, probabilities, [best, *rivals], strict=False)
        ),
        evidence={"log_odds": best.log_evidence, "lead": lead if np.isfinite(lead) else None},
        degenerate_directions=free,
        residual=best.residual,
        n_inliers=int(best.is_covered.sum()),
        n_keypoints=found.n_keypoints,
        n_correspondences=found.n_correspondences,
        links=_links(walk, poses[0], best),
    )


def _refusals(
    best: LineEvidence, free: tuple[DegenerateDirection, ...], lead: float, config: WalkDecisionConfig
) -> Iterator[Verdict]:
    """Reasons against the best pose, the most telling first."""
    is_clear = best.log_evidence >= config.clear_log_evidence
    needed = config.min_clear_coverage if is_clear else config.min_coverage
    if best.coverage < needed:
        yield Verdict(
            Status.NO_OVERLAP,
            f"only {best.coverage:.0%} of the walk falls inside the base map under the best pose "
            f"(needs {needed:.0%}); walk where the base was surveyed",
        )
    if best.residual > config.max_residual:
        yield Verdict(
            Status.INCONSISTENT,
            f"residuals along the walk are {best.residual:.1f} times what the base's own stretches show "
            f"(at most {config.max_residual:.1f}): probably a different place",
        )
    if best.log_evidence < config.min_log_evidence:
        yield Verdict(
            Status.INCONSISTENT,
            f"the evidence for the best pose is {best.log_evidence:.0f} nats (needs {config.min_log_evidence:.0f}); "
            "walk farther",
        )
    if lead < config.min_lead:
        yield Verdict(
            Status.AMBIGUOUS,
            f"another pose explains the walk nearly as well ({lead:.1f} nats behind, needs {config.min_lead:.0f}); "
            "see alternatives, or walk farther",
        )
    if free:
        yield Verdict(
            Status.DEGENERATE,
            f"the walk leaves the pose too free ({', '.join(d.words for d in free)}); walk farther or turn a corner",
        )


def _distinct(ranked: list[LineEvidence], distance: float) -> list[LineEvidence]:
    """Poses that differ from every better one."""
    kept: list[LineEvidence] = []
    for e in ranked:
        if not any(is_same_pose(e.T_base_walk, k.T_base_walk, e.center, distance) for k in kept):
            kept.append(e)
    return kept


def _links(walk: Walk, T_base_target: RigidTransform, best: LineEvidence) -> Links:
    """Bins inside the base map, and where the answer puts them."""
    p_target = transform_points(walk.positions[best.is_covered], walk.T_survey_walk)
    return Links(transform_points(p_target, T_base_target), p_target)
