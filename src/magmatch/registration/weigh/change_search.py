# SPDX-License-Identifier: BSD-3-Clause
"""If residuals show that something moved: poses that explain the cells which still agree."""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.spatial.transform import RigidTransform

from magmatch.estimation.limits import COARSE_STEPS, MOST_STEPS, N_CHANGED
from magmatch.estimation.pose_prior import PosePrior
from magmatch.estimation.posterior import in_order
from magmatch.progress import tell
from magmatch.registration.prepared.prepared_map import PreparedMap
from magmatch.registration.refine.changes import MAX_MISFIT, refine_beside_changes
from magmatch.registration.refine.refinement import RefinedPose, step_between
from magmatch.registration.weigh.cells import (
    UNCHANGED_SHARES,
    NullModels,
    agreeing_cells,
    compare_cells,
)
from magmatch.registration.weigh.evidence import Change, PoseEvidence, weigh_pose
from magmatch.typing import Indices


@dataclass(frozen=True, eq=False, slots=True)
class ChangeSearch:
    """Poses of a pair beside a change of the field.

    Moved sources bias a dense refinement of all cells; the poses of the search, which tolerates outliers, are closer
    to where the rest agrees.
    """

    base: PreparedMap
    target: PreparedMap
    nulls: NullModels
    prior: PosePrior
    seed: int

    def poses(self, starts: Sequence[RigidTransform], best: PoseEvidence, model: RefinedPose) -> list[PoseEvidence]:
        """Poses with a change beside them, if the best pose without one leaves residuals that are too large."""
        if not MAX_MISFIT < best.misfit < np.inf:
            return []
        tried = [replace(model, T_base_target=T) for T in [*starts, model.T_base_target]]
        agreements = sorted(((self._agreement(pose)[1], pose) for pose in tried), key=lambda pair: -pair[0])
        tell("something may have moved; looking for poses beside changes")
        found = [
            self._best_followed(pose) for agreement, pose in agreements[:N_CHANGED] if agreement + best.price > 0
        ]
        return in_order([*found, *(self._without_changed_cells(one.pose) for one in found if one is not None)])

    def _without_changed_cells(self, pose: RefinedPose) -> PoseEvidence | None:
        """Weigh a pose by the cells that agree alone: nothing is said of what changed in the others."""
        rows, agreement, _, n_cells = self._agreement(pose)
        if len(rows) == n_cells:
            return None
        left_out = Change(None, rows, len(rows) / n_cells, agreement)
        return weigh_pose(self.base, self.target, pose, self.nulls, self.prior, left_out)

    def _agreement(
        self, pose: RefinedPose, shares: Sequence[float] = UNCHANGED_SHARES
    ) -> tuple[Indices, float, float, int]:
        """Cells that agree, their evidence, the penalty for choosing them, and the number of cells to choose from."""
        field, null = pose.sensor.correct(self.target.sample_field), self.nulls.target
        seen = compare_cells(self.base, self.target, pose.T_base_target, field, null)
        return (*agreeing_cells(seen, null, shares), len(seen.rows))

    def _best_followed(self, start: RefinedPose) -> PoseEvidence | None:
        """The most likely result of refining a pose on the cells that agree, and on nearly all cells.

        The estimated change compensates small changes, so more cells can be used than agree without it.
        """
        best = self._follow(start)
        _, widest, wide, *_ = UNCHANGED_SHARES
        for share in (wide, widest):
            if best is not None and best.unchanged > share:
                continue
            wider = self._follow(start if best is None else best.pose, (share,))
            if wider is not None and (best is None or wider.log_evidence > best.log_evidence):
                best = wider
        return best

    def _follow(self, pose: RefinedPose, shares: Sequence[float] = UNCHANGED_SHARES) -> PoseEvidence | None:
        """Refine a pose on the cells that agree, then on those that agree with the result, until it converges.

        At last the cells stay: two choices may take turns for ever, each that of the other's pose.
        """
        base, target, nulls, prior = self.base, self.target, self.nulls, self.prior
        for n_steps in range(MOST_STEPS):
            if n_steps < COARSE_STEPS:
                rows, _, price, n_cells = self._agreement(pose, shares)
            agrees, rng = nulls.target.cells.holds(rows), np.random.default_rng(self.seed)
            found = refine_beside_changes(base, target, pose, agrees, prior, rng)
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
            return weighed if len(rows) < n_cells else None
        return None
