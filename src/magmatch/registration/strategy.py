# SPDX-License-Identifier: BSD-3-Clause
"""How a target is compared with a base, as a map or as a walk: the steps that both implement, and their order."""

from dataclasses import dataclass
from typing import Any, Generic, Protocol, TypeVar

import numpy as np
from scipy.spatial.transform import RigidTransform

from magmatch.data.survey import Survey
from magmatch.estimation.hypothesis import Hypothesis
from magmatch.estimation.model_prior import overlap_weight
from magmatch.estimation.pose_prior import PosePrior, PosePriorConfig, pose_prior
from magmatch.estimation.posterior import Answer, answers_of
from magmatch.field.map import FieldMap
from magmatch.registration.bases import Bases
from magmatch.registration.decide.decision import DecisionConfig
from magmatch.registration.decide.estimate import Estimate
from magmatch.registration.decide.support import Support
from magmatch.registration.index.map_index import MapIndex
from magmatch.registration.prepared.inside import spread_inside
from magmatch.registration.prepared.prepared_map import PreparedMap, common_length, height_range
from magmatch.registration.search.candidate import SearchResult
from magmatch.registration.weigh.bend import Bend

BaseSide = TypeVar("BaseSide")
TargetSide = TypeVar("TargetSide")
W = TypeVar("W", bound=Hypothesis)
Pose_contra = TypeVar("Pose_contra", bound=Hypothesis, contravariant=True)


@dataclass(frozen=True, slots=True)
class Among:
    """The state that all maps share which are searched for one target."""

    volume: float  # m^3: of all their regions
    length: float  # m: correlation length by which a walk is binned, so that none is judged by more bins

    @classmethod
    def of(cls, index: MapIndex) -> "Among":
        """One map alone."""
        return cls(index.volume, index.length)


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


MapPair = Pair[PreparedMap, PreparedMap]


def pair_maps(base: PreparedMap, target: PreparedMap, known: PosePriorConfig, volume: float) -> MapPair:
    """Two prepared maps; the prior covers a volume, m^3."""
    frames = base.T_map_model, target.T_map_model
    prior = pose_prior(known, *frames, volume, height_range(base))
    prior = spread_inside(prior, base.raster, target.points, overlap_weight)
    return Pair(base, target, prior, common_length(base, target), *frames)


@dataclass(frozen=True, eq=False, slots=True)
class Weighed(Generic[BaseSide, TargetSide, W]):
    """Poses of a pair, refined and weighed; nothing is decided yet."""

    strategy: "Strategy[BaseSide, TargetSide, W]"  # the one that weighed them, and can state and settle them
    pair: Pair[BaseSide, TargetSide]
    found: SearchResult
    ranked: list[W]  # hypotheses, pose and model, in any order
    elsewhere: float = -np.inf  # nats: log odds of the best pose in any other base; -inf if there is none

    def answers(self, config: DecisionConfig) -> list[Answer[W]]:
        """Hypotheses that are one answer at the accuracy asked for."""
        return answers_of(self.ranked, config.tolerance(self.pair.length))

    def best_log_odds(self, config: DecisionConfig) -> float:
        """Log odds of the most probable answer over unrelated surveys, nats; -inf if there is none."""
        return max((answer.log_odds for answer in self.answers(config)), default=-np.inf)


class Strategy(Protocol[BaseSide, TargetSide, Pose_contra]):
    """The steps of a registration, in their order."""

    @property
    def target(self) -> Survey | FieldMap:
        """The target as it was used."""

    def likely(self, bases: Bases) -> list[Any]:
        """Which of some maps are searched in full, most likely first."""

    def pair(self, base: MapIndex, among: Among | None = None) -> Pair[BaseSide, TargetSide]:
        """Both sides prepared for comparison, with what all maps searched share; of this base alone if None."""

    def search(self, pair: Pair[BaseSide, TargetSide]) -> SearchResult:
        """Find candidate poses."""

    def refine_and_weigh(self, pair: Pair[BaseSide, TargetSide], found: SearchResult) -> Weighed[Any, Any, Any]:
        """Refine the candidates against the field, and weigh each against the null model."""

    def state(self, pair: Pair[BaseSide, TargetSide], pose: Pose_contra) -> tuple[Estimate, Support]:
        """A pose as it was weighed, and its supporting figures."""

    def settle(self, pair: Pair[BaseSide, TargetSide], pose: Pose_contra) -> tuple[Estimate, Support]:
        """A probable pose, its covariance widened by what residuals do not show."""

    def bend(self, pair: Pair[BaseSide, TargetSide], pose: Pose_contra) -> Bend | None:
        """How the target bends about a pose, in the frames compared; None if it cannot be told."""
