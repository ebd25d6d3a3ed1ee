# SPDX-License-Identifier: BSD-3-Clause
"""A weighed pose as it is stated: with the pose prior, and with what no residual shows."""

from dataclasses import replace

import numpy as np

from magmatch.estimation.pose_prior import PosePrior
from magmatch.registration.prepared.prepared_map import PreparedMap
from magmatch.registration.refine.refinement import RefinementConfig
from magmatch.registration.weigh.covariance import drift_covariance, enclosing
from magmatch.registration.weigh.evidence import PoseEvidence
from magmatch.registration.weigh.map_covariance import map_covariance
from magmatch.registration.weigh.refine_and_weigh_walk import LineEvidence


def with_prior(pose: PoseEvidence, prior: PosePrior) -> PoseEvidence:
    """Combine what its cells show with the pose prior."""
    if pose.covariance is None or prior.is_flat:
        return pose
    T, covariance = prior.combined(pose.T_base_target, pose.center, pose.covariance)
    return replace(pose, pose=replace(pose.pose, T_base_target=T), covariance=covariance)


def settled(
    base: PreparedMap, target: PreparedMap, pose: PoseEvidence, config: RefinementConfig, seed: int
) -> PoseEvidence:
    """Widen the covariance by the maps' uncertainty between their samples, and by the surveys' drift.

    Far from a map's samples its error is nearly uniform: the pose follows it, and no residual shows it. If residuals
    do show it, both covariances describe the same error, so the larger is used, not the sum.
    """
    assert pose.covariance is not None  # otherwise it is not probable
    covariance = pose.covariance
    # Where a change was estimated, its covariance already covers this.
    if not pose.is_beside_change:
        covariance = enclosing(covariance, map_covariance(base, target, pose.pose, config, seed))
    return replace(pose, covariance=covariance + drift_covariance(pose.pose))


def with_frame_error(pose: LineEvidence, pose_sd: float) -> LineEvidence:
    """Widen by an error of a walk's frame as a whole: the base's own stretches show how poses drift, but not this."""
    return replace(pose, covariance=pose.covariance + np.diag([0.0] * 3 + [pose_sd**2] * 3))
