# SPDX-License-Identifier: BSD-3-Clause
"""A walk's pose refined from both sides: the base's map at the walk's samples, and the walk's own at the base's.

Where the base passed each place once, its left-out stretches cannot teach what another walk's residuals are like
(`path_noise.py`), and its map beside its own path is a guess that pulls the other path towards it. The walk's map
errs the same way in the opposite sense, so that the two together hardly do.
"""

import logging
from dataclasses import replace

import numpy as np

from magmatch.registration.config import RegistrationConfig
from magmatch.registration.decide.answer import refined
from magmatch.registration.index.walk_index import WalkIndex
from magmatch.registration.prepared.pose_prior import pose_prior
from magmatch.registration.prepared.prepared_map import PreparedMap
from magmatch.registration.refine.refinement import refine
from magmatch.registration.refine.sensors import levels_to_try
from magmatch.registration.result import RegistrationResult, Status
from magmatch.registration.weigh.evidence import null_model_of, weigh_pose
from magmatch.registration.weigh.map_covariance import map_covariance

log = logging.getLogger(__name__)


def needs_both_sides(walks: WalkIndex, answer: RegistrationResult) -> bool:
    """Whether the base cannot tell how sure a walk's pose is, which was found."""
    is_found = answer.status in (Status.ACCEPTED, Status.DEGENERATE)
    return is_found and not walks.noise.is_learned


def refine_from_both_sides(
    base: PreparedMap, target: PreparedMap, answer: RegistrationResult, config: RegistrationConfig, seed: int
) -> RegistrationResult:
    """Refine an answer as that of two maps."""
    log.info("refining the walk's pose from both sides")
    assert answer.best_pose is not None  # it was found
    prior = pose_prior(config.prior, base.T_map_model, target.T_map_model, base.raster.volume)
    start = base.T_map_model.inv() * answer.best_pose * target.T_map_model
    # Along a line, sensors that differ and a pose that is off look alike: they differ as little as configured.
    level = levels_to_try(config.refinement.sensor)[0]
    pose = refine(base, target, start, prior, config.refinement, np.random.default_rng(seed), level)
    best = weigh_pose(base, target, pose, null_model_of(base, target), prior)
    if best.covariance is None:
        return answer
    best = replace(best, covariance=best.covariance + map_covariance(base, target, pose, config.refinement, seed))
    return refined(answer, base, target, best, config.decision)
