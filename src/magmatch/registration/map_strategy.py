# SPDX-License-Identifier: BSD-3-Clause
"""The target as a map: poses are found by invariants, refined against both maps and weighed by independent cells."""

from dataclasses import dataclass
from typing import Any

import numpy as np

from magmatch.data.survey import Survey
from magmatch.field.map import FieldMap
from magmatch.registration.bases import Bases
from magmatch.registration.clock import Clock
from magmatch.registration.config import RegistrationConfig
from magmatch.registration.decide.estimate import Estimate
from magmatch.registration.decide.support import Support, support_of_map
from magmatch.registration.index.map_index import MapIndex
from magmatch.registration.maps import as_map
from magmatch.registration.prepared.prepared_map import PreparedMap, prepare
from magmatch.registration.search.candidate import SearchResult
from magmatch.registration.search.invariant_search import invariant_search
from magmatch.registration.strategy import Among, MapPair, Weighed, pair_maps
from magmatch.registration.weigh.bend import Bend, bend_of_map
from magmatch.registration.weigh.evidence import PoseEvidence
from magmatch.registration.weigh.rank import rank_poses
from magmatch.registration.weigh.settled import settled, with_prior


@dataclass(frozen=True, eq=False, slots=True)
class MapStrategy:
    """Implements `Strategy` for a target that can be mapped."""

    prepared: PreparedMap
    config: RegistrationConfig
    seed: int

    @classmethod
    def of(cls, target: Survey | FieldMap, config: RegistrationConfig, seed: int, clock: Clock) -> "MapStrategy":
        """Map the target, and evaluate everything that a search needs of it."""
        with clock("maps"):
            target_map = as_map(target, config.field)
        with clock("prepare"):
            prepared = prepare(target_map, config.invariants.n_draws, np.random.default_rng(seed))
        return cls(prepared, config, seed)

    @property
    def target(self) -> FieldMap:
        """The target's map."""
        return self.prepared.field_map

    def likely(self, bases: Bases) -> list[Any]:
        """Those in which a few poses agree best."""
        return bases.likely_for_map(self.prepared, self.seed)

    def pair(self, index: MapIndex, among: Among | None = None) -> MapPair:
        """Two prepared maps."""
        among = among or Among.of(index)
        return pair_maps(index.base, self.prepared, self.config.prior, among.volume)

    def search(self, pair: MapPair) -> SearchResult:
        """Poses under which local frames and invariants agree."""
        rng = np.random.default_rng(self.seed)
        return invariant_search(pair.base, pair.target, pair.prior, self.config.invariants, rng)

    def refine_and_weigh(self, pair: MapPair, found: SearchResult) -> Weighed[PreparedMap, PreparedMap, PoseEvidence]:
        """Refine poses against both maps, and weigh them; each cell of the target is evidence for or against."""
        settings = self.config.refinement, self.config.changes
        ranked = rank_poses(
            pair.base, pair.target, found.poses, pair.prior, *settings, self.seed, is_unordered=found.is_unordered
        )
        return Weighed(self, pair, found, ranked)

    def state(self, pair: MapPair, pose: PoseEvidence) -> tuple[Estimate, Support]:
        """Combine what its cells show with the pose prior."""
        pose = with_prior(pose, pair.prior)
        estimate = pair.estimate(pose)
        return estimate, support_of_map(pair.base, pair.target, pose, estimate.T_base_target)

    def settle(self, pair: MapPair, pose: PoseEvidence) -> tuple[Estimate, Support]:
        """Widen the covariance by what residuals do not show."""
        return self.state(pair, settled(pair.base, pair.target, pose, self.config.refinement, self.seed))

    def bend(self, pair: MapPair, pose: PoseEvidence) -> Bend | None:
        """The difference between the poses of the path's halves; where a change was estimated, it may bend them."""
        if pose.is_beside_change:
            return None
        return bend_of_map(pair.base, pair.target, pose.pose, pair.prior, self.config.refinement, self.seed)
