# SPDX-License-Identifier: BSD-3-Clause
"""From candidates to weighed poses: refine the best few, let the sensors differ, look for changes, finish."""

from collections.abc import Callable, Sequence

import numpy as np
from scipy.spatial.transform import RigidTransform

from magmatch.estimation.pose_prior import PosePrior
from magmatch.estimation.posterior import in_order
from magmatch.progress import tell
from magmatch.registration.prepared.prepared_map import PreparedMap
from magmatch.registration.refine.changes import ChangeConfig
from magmatch.registration.refine.refinement import RefinedPose, RefinementConfig, refine, step_between
from magmatch.registration.refine.sensors import levels_to_try
from magmatch.registration.weigh.cells import null_models_of
from magmatch.registration.weigh.change_search import ChangeSearch
from magmatch.registration.weigh.evidence import PoseEvidence, weigh_pose

Weigh = Callable[[RigidTransform | RefinedPose, RefinementConfig, int], PoseEvidence]


def rank_poses(
    base: PreparedMap,
    target: PreparedMap,
    starts: Sequence[RigidTransform],
    prior: PosePrior,
    refinement: RefinementConfig,
    changes: ChangeConfig,
    seed: int,
    *,
    is_unordered: bool = False,
) -> list[PoseEvidence]:
    """Refine candidates, all of them if they come in no order, and the best one under each model of what differs."""
    tell("refining the best poses")
    nulls = null_models_of(base, target)

    def weigh(start: RigidTransform | RefinedPose, settings: RefinementConfig, level: int) -> PoseEvidence:
        pose = refine(base, target, start, prior, settings, np.random.default_rng(seed), level)
        return weigh_pose(base, target, pose, nulls, prior)

    n_first = len(starts) if is_unordered else refinement.n_candidates
    ranked = _rank_candidates(starts, n_first, weigh, refinement)
    if not ranked:
        return ranked
    with_like_sensors = ranked[0].pose
    ranked = in_order([*_let_sensors_differ(ranked[0], weigh, refinement), *ranked])
    beside = ChangeSearch(base, target, nulls, prior, changes, seed).poses(starts, ranked[0], with_like_sensors)
    return [*_finish(ranked, weigh, refinement), *beside]


def _rank_candidates(
    starts: Sequence[RigidTransform], n_first: int, weigh: Weigh, settings: RefinementConfig
) -> list[PoseEvidence]:
    """Refine the first candidates, and the others if none of them is clear."""
    ranking, level = settings.for_ranking(), levels_to_try(settings.sensor)[0]
    ranked = [weigh(start, ranking, level) for start in starts[:n_first]]
    if max((e.log_evidence for e in ranked), default=-np.inf) < settings.clear_log_evidence:
        ranked += [weigh(start, ranking, level) for start in starts[n_first:]]
    return in_order(ranked)


def _let_sensors_differ(best: PoseEvidence, weigh: Weigh, settings: RefinementConfig) -> list[PoseEvidence]:
    """The best pose with ever wider priors on the sensors' difference, as long as a wider one is more probable."""
    _, *wider = levels_to_try(settings.sensor)
    found = list[PoseEvidence]()
    for level in wider:
        found.append(weigh(best.pose.T_base_target, settings.for_ranking(), level))
        if found[-1].log_evidence < best.log_evidence:
            break
        best = found[-1]
    return found


def _finish(ranked: list[PoseEvidence], weigh: Weigh, settings: RefinementConfig) -> list[PoseEvidence]:
    """Refine to convergence the best pose, and those with nearly as much evidence."""
    # Starts that converged to the best pose are not rivals of it.
    ranked = [e for k, e in enumerate(ranked) if not (k and _rest_together(ranked[0], e))]
    level = levels_to_try(settings.sensor)[0]
    n_finished = sum(e is ranked[0] or e.log_evidence > ranked[0].log_evidence / 2 for e in ranked)
    ranked[:n_finished] = [weigh(e.pose, settings, level) for e in ranked[:n_finished]]
    return in_order(ranked)


def _rest_together(one: PoseEvidence, other: PoseEvidence) -> bool:
    """Whether two poses refined under one model differ by less than the first is uncertain by."""
    if one.covariance is None or one.model != other.model:
        return False
    step = step_between(one.pose, other.pose)
    return bool(step @ np.linalg.solve(one.covariance, step) < len(step))
