# SPDX-License-Identifier: BSD-3-Clause
"""A base and a target, made ready to be compared."""

from dataclasses import dataclass
from typing import Generic, TypeVar

from scipy.spatial.transform import RigidTransform

from magmatch.estimation.pose_prior import PosePrior
from magmatch.estimation.posterior import Hypothesis
from magmatch.registration.decide.estimate import Estimate

BaseSide = TypeVar("BaseSide")
TargetSide = TypeVar("TargetSide")


@dataclass(frozen=True, eq=False, slots=True)
class Pair(Generic[BaseSide, TargetSide]):
    """Base and target prepared for a strategy, and the pose prior."""

    base: BaseSide
    target: TargetSide
    prior: PosePrior
    length: float  # m: correlation length of the field, the scale of tolerances
    # Survey frames from the frames in which poses are searched
    T_base_model: RigidTransform
    T_target_model: RigidTransform

    def estimate(self, pose: Hypothesis) -> Estimate:
        """A pose of this pair in the surveys' frames."""
        return Estimate.of(pose, self.T_base_model, self.T_target_model)
