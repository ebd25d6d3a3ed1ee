# SPDX-License-Identifier: BSD-3-Clause
"""From judged poses to the result in the surveys' own frames."""

from dataclasses import replace

import numpy as np
from scipy.spatial.transform import RigidTransform

from magmatch.geometry import rotate_vectors, rotation_matrix, transform_points
from magmatch.registration.decide.decision import (
    DEGENERATE_REASON,
    DecisionConfig,
    decide,
    odds_in_words,
)
from magmatch.registration.decide.fitness import mean_misalignment
from magmatch.registration.decide.probability import pose_probability, shares
from magmatch.registration.decide.same_pose import is_same_pose
from magmatch.registration.prepared.prepared_map import PreparedMap, common_length
from magmatch.registration.refine.sensors import TIED_SD
from magmatch.registration.result import Alternative, DegenerateDirection, Links, RegistrationResult, Sensor, Status
from magmatch.registration.search.candidate import SearchResult
from magmatch.registration.weigh.covariance import free_directions, to_survey_axes
from magmatch.registration.weigh.evidence import PoseEvidence
from magmatch.typing import Covariance6

# Poses nearer than this are one answer, in correlation lengths.
SAME_PLACE = 0.7
N_LINKS = 200  # enough for a picture


def by_evidence(
    base: PreparedMap,
    target: PreparedMap,
    found: SearchResult,
    ranked: list[PoseEvidence],
    config: DecisionConfig,
    lead: float = np.inf,
    decoy_evidence: float | None = None,
) -> RegistrationResult:
    """Judge refined poses by their cells and state the answer in survey frames.

    Parameters
    ----------
    base, target : PreparedMap
    found : SearchResult
        Counts of the search.
    ranked : list of PoseEvidence
        Best first.
    config : DecisionConfig
    lead : float, nats
        Over the best pose in any other map.
    decoy_evidence : float or None, nats
        Log evidence that the search reaches in places that do not exist (see `decoys`); None where not tried.

    Returns
    -------
    RegistrationResult
    """
    if not ranked:
        verdict = decide(ranked, False, np.inf, decoy_evidence, config)
        return RegistrationResult(verdict.status, verdict.reason, None, n_keypoints=found.n_keypoints)
    best = ranked[0]
    distance, center = SAME_PLACE * common_length(base, target), best.pose.center
    rivals = [
        e for e in ranked[1:] if not is_same_pose(best.pose.T_base_target, e.pose.T_base_target, center, distance)
    ]
    elsewhere = best.log_evidence - lead
    lead = min([lead, *(best.log_evidence - e.log_evidence for e in rivals)])
    poses = [_to_surveys(e.pose.T_base_target, base, target) for e in [best, *rivals]]
    free = _free_directions(best, base, target, config)
    verdict = decide(ranked, bool(free) or best.covariance is None, lead, decoy_evidence, config)
    probabilities = _probabilities(best, rivals, elsewhere, decoy_evidence)
    is_accepted = verdict.status is Status.ACCEPTED
    return RegistrationResult(
        status=verdict.status,
        reason=verdict.reason,
        T_base_target=poses[0] if is_accepted else None,
        covariance=covariance_of(best, target) if is_accepted else None,
        probability=probabilities[0],
        overlap=best.overlap,
        # A unique answer has no alternatives; a refusal shows what was considered, best first.
        alternatives=()
        if is_accepted
        else tuple(
            Alternative(T, probability, log_odds=e.log_evidence)
            for T, probability, e in zip(poses, probabilities, [best, *rivals], strict=True)
        ),
        evidence=_statistics(best, lead, decoy_evidence),
        degenerate_directions=free,
        sensor=_sensor(best, target),
        residual=best.residual if np.isfinite(best.residual) else None,
        fitness=_fitness(base, target, best),
        n_inliers=best.n_good,
        n_keypoints=found.n_keypoints,
        n_correspondences=found.n_correspondences,
        links=_links(target, poses[0], best),
    )


def refined(
    answer: RegistrationResult, base: PreparedMap, target: PreparedMap, best: PoseEvidence, config: DecisionConfig
) -> RegistrationResult:
    """Give an answer the pose that a further refinement found."""
    pose, free = _to_surveys(best.pose.T_base_target, base, target), _free_directions(best, base, target, config)
    answer = replace(
        answer,
        degenerate_directions=free,
        sensor=_sensor(best, target),
        residual=best.residual,
        fitness=_fitness(base, target, best),
        links=_links(target, pose, best),
    )
    if not free:
        return replace(
            answer,
            status=Status.ACCEPTED,
            reason=odds_in_words(answer.evidence["log_odds"], answer.evidence["lead"]),
            T_base_target=pose,
            covariance=covariance_of(best, target),
            alternatives=(),
        )
    return replace(
        answer,
        status=Status.DEGENERATE,
        reason=DEGENERATE_REASON,
        T_base_target=None,
        covariance=None,
        alternatives=(Alternative(pose, answer.probability, log_odds=answer.evidence["log_odds"]),),
    )


def _probabilities(
    best: PoseEvidence, rivals: list[PoseEvidence], elsewhere: float, decoy_evidence: float | None
) -> list[float]:
    """Of the best pose and its rivals; what another map holds counts as one more."""
    explained = pose_probability(best.log_evidence, decoy_evidence, best.misfit, best.good_share)
    odds = [best.log_evidence, *(e.log_evidence for e in rivals)]
    return [explained * share for share in shares([*odds, elsewhere])[: len(odds)]]


def _statistics(best: PoseEvidence, lead: float, decoy_evidence: float | None) -> dict[str, float | None]:
    """What decided, as numbers."""
    return {
        "log_odds": best.log_evidence,
        "lead": lead if np.isfinite(lead) else None,
        "decoy_log_odds": decoy_evidence if decoy_evidence is not None and np.isfinite(decoy_evidence) else None,
        "misfit": best.misfit,
        "unexplained": best.unexplained,
        "agreeing_share": best.good_share,
        "n_informative": float(best.n_informative),
        "unchanged": best.unchanged,
    }


def _free_directions(
    best: PoseEvidence, base: PreparedMap, target: PreparedMap, config: DecisionConfig
) -> tuple[DegenerateDirection, ...]:
    if best.covariance is None:
        return ()
    return free_directions(
        best.covariance,
        best.pose.center,
        target.T_map_model,
        rotation_matrix(_to_surveys(best.pose.T_base_target, base, target)),
        config.max_sd_rotation,
        config.max_sd_translation * common_length(base, target),
    )


def covariance_of(best: PoseEvidence, target: PreparedMap) -> Covariance6 | None:
    """Of xi in the target's survey frame."""
    covariance = best.whole_covariance
    return None if covariance is None else to_survey_axes(covariance, best.pose.center, target.T_map_model)


def _to_surveys(T: RigidTransform, base: PreparedMap, target: PreparedMap) -> RigidTransform:
    """From model frames to survey frames."""
    return base.T_map_model * T * target.T_map_model.inv()


def _fitness(base: PreparedMap, target: PreparedMap, best: PoseEvidence) -> float | None:
    T = best.pose.T_base_target
    expected, _, _, is_known = base.raster.lookup(transform_points(target.samples, T))
    aligned = rotate_vectors(best.pose.sensor.correct(target.sample_field), T)
    return mean_misalignment(aligned[is_known], expected[is_known]) if is_known.any() else None


def _sensor(best: PoseEvidence, target: PreparedMap) -> Sensor | None:
    """Estimated difference of the magnetometers in the target's survey axes; None where it was not estimated."""
    sensor = best.pose.sensor
    if best.pose.sensor_sd.max() <= TIED_SD:
        return None
    R = rotation_matrix(target.T_map_model)
    gain = R @ sensor.gain @ R.T
    return {
        "bias": [float(c) for c in R @ sensor.bias],
        # Turning does not change it, but rounds it.
        "scale": float(np.trace(sensor.gain) / 3),
        "gain": [[float(g) for g in row] for row in gain],
        "prior_sd": [float(s) for s in best.pose.sensor_sd],
    }


def _links(target: PreparedMap, T_base_target: RigidTransform, best: PoseEvidence) -> Links:
    """Distinct target samples that the base explains, and where the answer puts them."""
    if not best.pose.blocks:
        return Links(np.zeros((0, 3)), np.zeros((0, 3)))
    forward = best.pose.blocks[0]
    rows = np.flatnonzero(forward.residual2 < 12.0)
    rows = rows[np.linspace(0, len(rows) - 1, min(N_LINKS, len(rows))).astype(int)]
    p_target = transform_points(forward.positions[rows], target.T_map_model)
    return Links(transform_points(p_target, T_base_target), p_target)
