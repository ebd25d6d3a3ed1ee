# SPDX-License-Identifier: BSD-3-Clause
"""The verb for maps: search, refine and weigh poses of one map in another; judging them comes last."""

import logging
from dataclasses import dataclass, replace

import numpy as np
from scipy.spatial.transform import RigidTransform

from magmatch.registration.clock import Stopwatch
from magmatch.registration.config import RegistrationConfig
from magmatch.registration.decide.answer import by_evidence, covariance_of
from magmatch.registration.prepared.pose_prior import PosePrior, pose_prior
from magmatch.registration.prepared.prepared_map import PreparedMap
from magmatch.registration.published.keypoint_search import keypoint_search
from magmatch.registration.refine.refinement import RefinedPose, RefinementConfig, refine, step_between
from magmatch.registration.refine.sensors import is_soft_iron, levels_to_try
from magmatch.registration.result import RegistrationResult
from magmatch.registration.search.candidate import SearchResult
from magmatch.registration.search.invariant_search import invariant_search
from magmatch.registration.weigh.change_search import poses_beside_changes
from magmatch.registration.weigh.covariance import enclosing
from magmatch.registration.weigh.decoys import decoys
from magmatch.registration.weigh.evidence import PoseEvidence, null_model_of, weigh_pose
from magmatch.registration.weigh.map_covariance import map_covariance

log = logging.getLogger(__name__)

# Poses that differ by less, in standard deviations, are one.
SAME_OPTIMUM_SDS = 0.5


@dataclass(frozen=True, eq=False, slots=True)
class WeighedMap:
    """A target's poses in one base map, weighed but not judged.

    Attributes
    ----------
    found : SearchResult
        Counts of the search.
    ranked : list of PoseEvidence
        Best first.
    """

    base: PreparedMap
    target: PreparedMap
    prior: PosePrior
    found: SearchResult
    ranked: list[PoseEvidence]

    @property
    def log_density(self) -> float:
        """Log evidence of the best pose, comparable between bases; -inf where there is none."""
        return self.ranked[0].log_evidence if self.ranked else -np.inf


def search_map(
    base: PreparedMap,
    target: PreparedMap,
    config: RegistrationConfig,
    seed: int,
    clock: Stopwatch,
    volume: float,
) -> WeighedMap:
    """Search, refine against the field, weigh.

    Parameters
    ----------
    base, target : PreparedMap
    config : RegistrationConfig
    seed : int
    clock : Stopwatch
    volume : float, m^3
        Of the regions in which the target is looked for, this base's or those of many.

    Returns
    -------
    WeighedMap
    """
    prior = pose_prior(config.prior, base.T_map_model, target.T_map_model, volume)
    found = clock.time("search", _search, base, target, prior, config, np.random.default_rng(seed))
    log.info("refining the best poses")
    ranked = clock.time("refine", _refine_and_rank, base, target, found, prior, config, seed)
    return WeighedMap(base, target, prior, found, ranked)


def judge_map(weighed: WeighedMap, config: RegistrationConfig, seed: int, lead: float = np.inf) -> RegistrationResult:
    """Accept or refuse the best pose.

    Parameters
    ----------
    weighed : WeighedMap
    config : RegistrationConfig
    seed : int
    lead : float, nats
        Over the best pose in any other map.

    Returns
    -------
    RegistrationResult
    """

    def judge(decoy_evidence: float | None) -> RegistrationResult:
        w = weighed
        return by_evidence(w.base, w.target, w.found, w.ranked, config.decision, lead, decoy_evidence)

    answer = judge(None)
    # A rough pose leaves little to chance, and a mirror has none.
    is_searched = config.search != "keypoints" and weighed.prior.T_base_target is None
    if answer.is_accepted and is_searched and weighed.log_density < config.decision.certain_log_evidence:
        answer = judge(_decoy_evidence(weighed, config, seed))
    return _beyond_residuals(answer, weighed, config, seed) if answer.is_accepted else answer


def _beyond_residuals(
    answer: RegistrationResult, weighed: WeighedMap, config: RegistrationConfig, seed: int
) -> RegistrationResult:
    """An accepted answer with a covariance that knows what the maps do not.

    Far from a map's samples its error is alike everywhere: the pose follows it, and no residual tells. Where
    residuals do tell of it, both say the same: the larger is taken, not the sum.
    """
    best = weighed.ranked[0]
    # Beside a change, what is left free is counted there.
    if best.covariance is None or best.is_beside_change:
        return answer
    of_maps = map_covariance(weighed.base, weighed.target, best.pose, config.refinement, seed)
    whole = replace(best, covariance=enclosing(best.covariance, of_maps))
    return replace(answer, covariance=covariance_of(whole, weighed.target))


def _decoy_evidence(weighed: WeighedMap, config: RegistrationConfig, seed: int) -> float:
    """Log evidence that the same search reaches in places that do not exist."""
    log.info("searching places that do not exist")
    reached, is_beside_change = -np.inf, weighed.ranked[0].is_beside_change
    for base, prior in decoys(weighed.base, weighed.prior):
        found = _search(base, weighed.target, prior, config, np.random.default_rng(seed))
        ranked = _refine_and_rank(base, weighed.target, found, prior, config, seed)
        # Evidence of cells and of samples beside a change are not of one scale.
        reached = max([reached, *(e.log_evidence for e in ranked if e.is_beside_change == is_beside_change)])
    return reached


def _search(
    base: PreparedMap, target: PreparedMap, prior: PosePrior, config: RegistrationConfig, rng: np.random.Generator
) -> SearchResult:
    """Poses in model frames, whichever search is configured."""
    if config.search != "keypoints":
        return invariant_search(base, target, prior, config.invariants, rng)
    found = keypoint_search(base.field_map, target.field_map, config.keypoints, rng)
    to_model = base.T_map_model.inv()
    candidates = tuple(
        replace(c, T_base_target=to_model * c.T_base_target * target.T_map_model) for c in found.candidates
    )
    return replace(found, candidates=candidates)


def _refine_and_rank(
    base: PreparedMap,
    target: PreparedMap,
    found: SearchResult,
    prior: PosePrior,
    config: RegistrationConfig,
    seed: int,
) -> list[PoseEvidence]:
    """Refine the best candidates and order them by their evidence."""
    settings = config.refinement
    starts: list[RigidTransform] = [c.T_base_target for c in found.candidates]
    null_model = null_model_of(base, target)
    tightest, *wider = levels_to_try(settings.sensor)

    def weigh(start: RigidTransform | RefinedPose, settings: RefinementConfig, level: int) -> PoseEvidence:
        pose = refine(base, target, start, prior, settings, np.random.default_rng(seed), level)
        return weigh_pose(base, target, pose, null_model, prior)

    ranking = settings.for_ranking()
    ranked = [weigh(start, ranking, tightest) for start in starts[: settings.n_candidates]]
    if max((e.log_evidence for e in ranked), default=-np.inf) < settings.clear_log_evidence:
        more = starts[settings.n_candidates : settings.n_candidates + settings.n_more_candidates]
        ranked += [weigh(start, ranking, tightest) for start in more]
    ranked.sort(key=_by_evidence)
    if not ranked:
        return ranked
    best_alike = ranked[0].pose
    alike = settings.sensor.bias_levels[0]
    for level in wider:
        if is_soft_iron(settings.sensor, level) and ranked[0].pose.sensor_sd[0] == alike:
            break  # sensors that differ in no bias and no scale
        best = weigh(ranked[0].pose.T_base_target, ranking, level)
        if best.log_evidence > ranked[0].log_evidence + settings.sensor.min_gain:
            ranked[0] = best
    beside = poses_beside_changes(
        base, target, starts, ranked[0], best_alike, null_model, prior, config.changes, seed
    )
    if beside:
        return beside
    # Starts that came to rest where the best did are no rivals of it.
    ranked = [e for k, e in enumerate(ranked) if not (k and _rest_together(ranked[0], e))]
    # The answer, and what comes near enough to be one.
    n_finished = sum(e is ranked[0] or e.log_evidence > ranked[0].log_evidence / 2 for e in ranked)
    ranked[:n_finished] = [weigh(e.pose, settings, tightest) for e in ranked[:n_finished]]
    ranked.sort(key=_by_evidence)
    return ranked


def _by_evidence(weighed: PoseEvidence) -> float:
    return -weighed.log_evidence


def _rest_together(one: PoseEvidence, other: PoseEvidence) -> bool:
    """Whether two refined poses differ by less than the first is uncertain by."""
    if one.covariance is None:
        return False
    step = step_between(one.pose, other.pose)
    return bool(step @ np.linalg.solve(one.covariance, step) < SAME_OPTIMUM_SDS**2 * len(step))
