# SPDX-License-Identifier: BSD-3-Clause
"""From candidates to weighed poses: refine the best few, let the sensors differ, look for changes, finish."""

from collections.abc import Callable, Sequence

import numpy as np
from scipy.spatial.transform import RigidTransform

from magmatch.estimation.limits import CLEAR, MOST_POINTS, N_REFINED, RANKING_POINTS
from magmatch.estimation.pose_prior import PosePrior
from magmatch.estimation.posterior import in_order
from magmatch.progress import tell
from magmatch.registration.prepared.prepared_map import PreparedMap
from magmatch.registration.refine.refinement import RefinedPose, refine, step_between
from magmatch.registration.refine.sensors import SensorMode, levels_to_try
from magmatch.registration.weigh.cells import null_models_of
from magmatch.registration.weigh.change_search import ChangeSearch
from magmatch.registration.weigh.evidence import PoseEvidence, weigh_pose

# Refine a start, or a pose further, by some samples at a level of the sensors, and weigh it.
Weigh = Callable[[RigidTransform | RefinedPose, int, int], PoseEvidence]


def rank_poses(
    base: PreparedMap,
    target: PreparedMap,
    starts: Sequence[RigidTransform],
    prior: PosePrior,
    sensors: SensorMode,
    seed: int,
    *,
    is_unordered: bool = False,
) -> list[PoseEvidence]:
    """Refine candidates, all of them if they come in no order, and the best one under each model of what differs."""
    tell("refining the best poses")
    nulls = null_models_of(base, target)
    level, *wider = levels_to_try(sensors)

    def weigh(start: RigidTransform | RefinedPose, n_samples: int, level: int) -> PoseEvidence:
        pose = refine(base, target, start, prior, sensors, np.random.default_rng(seed), level, n_samples)
        return weigh_pose(base, target, pose, nulls, prior)

    n_first = len(starts) if is_unordered else N_REFINED
    ranked = [weigh(start, RANKING_POINTS, level) for start in starts[:n_first]]
    if max((e.log_evidence for e in ranked), default=-np.inf) < CLEAR:
        ranked += [weigh(start, RANKING_POINTS, level) for start in starts[n_first:]]
    if not ranked:
        return []
    ranked = in_order(ranked)
    with_like_sensors = ranked[0].pose
    ranked = in_order([*_let_sensors_differ(ranked[0], weigh, wider), *ranked])
    beside = ChangeSearch(base, target, nulls, prior, seed).poses(starts, ranked[0], with_like_sensors)
    return [*_finish(ranked, weigh, level), *beside]


def _let_sensors_differ(best: PoseEvidence, weigh: Weigh, wider: Sequence[int]) -> list[PoseEvidence]:
    """The best pose with ever wider priors on the sensors' difference, as long as a wider one is more probable."""
    found = list[PoseEvidence]()
    for level in wider:
        found.append(weigh(best.pose.T_base_target, RANKING_POINTS, level))
        if found[-1].log_evidence < best.log_evidence:
            break
        best = found[-1]
    return found


def _finish(ranked: list[PoseEvidence], weigh: Weigh, level: int) -> list[PoseEvidence]:
    """Refine to convergence the best pose, and those with nearly as much evidence."""
    # Starts that converged to the best pose are not rivals of it.
    ranked = [e for k, e in enumerate(ranked) if not (k and _rest_together(ranked[0], e))]
    n_finished = sum(e is ranked[0] or e.log_evidence > ranked[0].log_evidence / 2 for e in ranked)
    ranked[:n_finished] = [weigh(e.pose, MOST_POINTS, level) for e in ranked[:n_finished]]
    return in_order(ranked)


def _rest_together(one: PoseEvidence, other: PoseEvidence) -> bool:
    """Whether two poses refined under one model differ by less than the first is uncertain by."""
    if one.covariance is None or one.model != other.model:
        return False
    step = step_between(one.pose, other.pose)
    return bool(step @ np.linalg.solve(one.covariance, step) < len(step))
