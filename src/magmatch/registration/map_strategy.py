# SPDX-License-Identifier: BSD-3-Clause
"""The target as a map: poses are found by invariants, refined against both maps and weighed by independent cells."""

from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from magmatch.data.survey import Survey
from magmatch.estimation.limits import N_DRAWS
from magmatch.estimation.model_prior import overlap_weight
from magmatch.estimation.pose_prior import PosePrior, pose_prior
from magmatch.field.map import FieldMap
from magmatch.registration.clock import Clock
from magmatch.registration.config import RegistrationConfig
from magmatch.registration.decide.estimate import Estimate, Pair
from magmatch.registration.decide.support import Support, support_of_map
from magmatch.registration.index.atlas import Bases
from magmatch.registration.index.map_index import MapIndex
from magmatch.registration.maps import as_map
from magmatch.registration.prepared.inside import spread_inside
from magmatch.registration.prepared.prepared_map import PreparedMap, common_length, height_range, prepare
from magmatch.registration.refine.sensors import SensorMode
from magmatch.registration.search.candidate import SearchResult
from magmatch.registration.search.invariant_search import invariant_search
from magmatch.registration.weigh.bend import Bend, bend_of_map
from magmatch.registration.weigh.covariance import drift_covariance, enclosing, map_covariance
from magmatch.registration.weigh.evidence import PoseEvidence
from magmatch.registration.weigh.rank import rank_poses

MapPair = Pair[PreparedMap, PreparedMap]


@dataclass(frozen=True, eq=False, slots=True)
class MapStrategy:
    """The steps for a target that can be mapped; of a walk: `WalkStrategy`."""

    prepared: PreparedMap
    config: RegistrationConfig
    seed: int

    @classmethod
    def of(cls, target: Survey | FieldMap, config: RegistrationConfig, seed: int, clock: Clock) -> "MapStrategy":
        """Map the target, and evaluate everything that a search needs of it."""
        with clock("maps"):
            target_map = as_map(target, config.field)
        with clock("prepare"):
            prepared = prepare(target_map, N_DRAWS, np.random.default_rng(seed))
        return cls(prepared, config, seed)

    @property
    def target(self) -> FieldMap:
        """The target as it was used."""
        return self.prepared.field_map

    @property
    def sensors(self) -> SensorMode:
        """What may differ between the two magnetometers."""
        return self.config.refinement.sensor.mode

    def likely(self, bases: Bases) -> list[Any]:
        """Those in which a few poses agree best, the best first: they are searched in full."""
        return bases.likely_for_map(self.prepared, self.seed)

    def pair(self, index: MapIndex, volume: float | None = None, _: float | None = None) -> MapPair:
        """Two prepared maps; the prior covers the volume (m^3) of all bases, of this one alone if it is None."""
        base, target = index.base, self.prepared
        frames = base.T_map_model, target.T_map_model
        prior = pose_prior(self.config.prior, *frames, volume or index.volume, height_range(base))
        prior = spread_inside(prior, base.raster, target.points, overlap_weight)
        return Pair(base, target, prior, common_length(base, target), *frames)

    def search(self, pair: MapPair) -> SearchResult:
        """Poses under which local frames and invariants agree."""
        rng = np.random.default_rng(self.seed)
        return invariant_search(pair.base, pair.target, pair.prior, rng)

    def refine_and_weigh(
        self,
        pair: MapPair,
        found: SearchResult,
        ahead: float | None = None,  # noqa: ARG002  # each of many maps is weighed alike
    ) -> list[PoseEvidence]:
        """Refine poses against both maps, and weigh them; each cell of the target is evidence for or against."""
        return rank_poses(
            pair.base, pair.target, found.poses, pair.prior, self.sensors, self.seed, is_unordered=found.is_unordered
        )

    def state(self, pair: MapPair, pose: PoseEvidence) -> tuple[Estimate, Support]:
        """State a pose by what its cells show and the pose prior, with its supporting figures."""
        pose = with_prior(pose, pair.prior)
        estimate = pair.estimate(pose)
        return estimate, support_of_map(pair.base, pair.target, pose, estimate.T_base_target)

    def settle(self, pair: MapPair, pose: PoseEvidence) -> tuple[Estimate, Support]:
        """State a probable pose: its covariance is widened by what residuals do not show.

        Far from a map's samples its error is nearly uniform: the pose follows it, and no residual shows it. If
        residuals do show it, both covariances describe the same error, so the larger is used, not the sum. The
        surveys' drift is no error of the maps, and is added.
        """
        assert pose.covariance is not None  # otherwise it is not probable
        covariance = pose.covariance
        # Where a change was estimated, its covariance already covers this.
        if not pose.is_beside_change:
            of_maps = map_covariance(pair.base, pair.target, pose.pose, self.seed)
            covariance = enclosing(covariance, of_maps)
        return self.state(pair, replace(pose, covariance=covariance + drift_covariance(pose.pose)))

    def bend(self, pair: MapPair, pose: PoseEvidence) -> Bend | None:
        """The difference between the poses of the path's halves; what drifts can look as if something had moved."""
        return bend_of_map(pair.base, pair.target, pose.pose, pair.prior, self.sensors, self.seed)


def with_prior(pose: PoseEvidence, prior: PosePrior) -> PoseEvidence:
    """Combine what its cells show with the pose prior."""
    if pose.covariance is None or prior.is_flat:
        return pose
    T, covariance = prior.combined(pose.T_base_target, pose.center, pose.covariance)
    return replace(pose, pose=replace(pose.pose, T_base_target=T), covariance=covariance)
