# SPDX-License-Identifier: BSD-3-Clause
"""If residuals show that something moved: poses that explain the cells which still agree."""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from scipy.spatial.transform import RigidTransform

from magmatch.progress import tell
from magmatch.registration.prepared.pose_prior import PosePrior
from magmatch.registration.prepared.prepared_map import PreparedMap
from magmatch.registration.refine.changes import ChangeConfig, refine_beside_changes
from magmatch.registration.refine.refinement import RefinedPose, step_between
from magmatch.registration.weigh.cells import (
    UNCHANGED_SHARES,
    NullModels,
    agreeing_cells,
    compare_cells,
)
from magmatch.registration.weigh.evidence import Change, PoseEvidence, weigh_pose
from magmatch.typing import Indices

# Shares of the cells that are tried beside a change, whatever agrees without one.
WIDER_SHARES = (0.7, 0.85)


def poses_beside_changes(
    base: PreparedMap,
    target: PreparedMap,
    starts: list[RigidTransform],
    best: PoseEvidence,
    model: RefinedPose,
    nulls: NullModels,
    prior: PosePrior,
    config: ChangeConfig,
    seed: int,
) -> list[PoseEvidence]:
    """Find poses together with a change of the field, if the residuals without a change are too large.

    Moved sources bias a dense refinement of all cells; the poses of the search, which tolerates outliers, are closer
    to where the rest agrees.
    """
    if not config.is_enabled or not config.max_misfit < best.misfit < np.inf:
        return []
    agreements = [
        (_agreement(base, target, replace(model, T_base_target=T), nulls)[1], T)
        for T in [*starts, model.T_base_target]
    ]
    agreements.sort(key=lambda pair: -pair[0])
    tell("something may have moved; looking for poses beside changes")
    found = [
        _best_followed(base, target, replace(model, T_base_target=T), nulls, prior, config, seed)
        for agreement, T in agreements[: config.n_candidates]
        if agreement > config.min_agreement
    ]
    beside = sorted((e for e in found if e is not None), key=lambda e: -e.log_evidence)
    return beside if beside and beside[0].log_evidence > 0 else []


def _agreement(
    base: PreparedMap,
    target: PreparedMap,
    pose: RefinedPose,
    nulls: NullModels,
    shares: Sequence[float] = UNCHANGED_SHARES,
) -> tuple[Indices, float, float, int]:
    """Cells that agree, their evidence, the penalty for choosing them, and the number of cells to choose from."""
    field = pose.sensor.correct(target.sample_field)
    seen = compare_cells(base, target, pose.T_base_target, field, nulls.target)
    return (*agreeing_cells(seen, nulls.target, shares), len(seen.rows))


def _best_followed(
    base: PreparedMap,
    target: PreparedMap,
    start: RefinedPose,
    nulls: NullModels,
    prior: PosePrior,
    config: ChangeConfig,
    seed: int,
) -> PoseEvidence | None:
    """The most likely result of refining a pose on the cells that agree, and on larger shares of the cells.

    The estimated change compensates small changes, so more cells can be used than agree without it.
    """
    best = _follow(base, target, start, nulls, prior, config, seed, UNCHANGED_SHARES)
    for share in WIDER_SHARES:
        if best is not None and best.unchanged > share - 0.05:
            continue
        pose = start if best is None else best.pose
        wider = _follow(base, target, pose, nulls, prior, config, seed, (share,))
        if wider is not None and (best is None or wider.log_evidence > best.log_evidence):
            best = wider
    return best


def _follow(
    base: PreparedMap,
    target: PreparedMap,
    pose: RefinedPose,
    nulls: NullModels,
    prior: PosePrior,
    config: ChangeConfig,
    seed: int,
    shares: Sequence[float],
) -> PoseEvidence | None:
    """Refine a pose on the cells that agree, then on those that agree with the result, until it converges."""
    for _ in range(config.n_rounds):
        rows, _, price, n_cells = _agreement(base, target, pose, nulls, shares)
        agrees, rng = nulls.target.cells.holds(rows), np.random.default_rng(seed)
        found = refine_beside_changes(base, target, pose, agrees, prior, config, rng)
        if found is None:
            return None
        change = Change(found.change_at(target.samples), rows, len(rows) / n_cells, found.log_ratio - price)
        weighed = weigh_pose(base, target, found.pose, nulls, prior, change)
        if weighed.covariance is None:
            return None
        step, pose = step_between(pose, found.pose), found.pose
        if float(step @ np.linalg.solve(weighed.covariance, step)) > len(step):
            continue
        # If no cells agree better than others, the change explains the residuals of any pose.
        explains = weighed.misfit < config.max_misfit and found.noise < config.max_noise
        return weighed if len(rows) < n_cells and explains else None
    return None
