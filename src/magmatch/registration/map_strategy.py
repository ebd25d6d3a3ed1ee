# SPDX-License-Identifier: BSD-3-Clause
"""The target as a map: invariants find poses, both maps refine them, independent cells weigh them."""

import logging
from dataclasses import dataclass, replace

import numpy as np

from magmatch.data.survey import Survey
from magmatch.field.map import FieldMap
from magmatch.registration.clock import Clock
from magmatch.registration.config import RegistrationConfig
from magmatch.registration.decide.answer import by_evidence, covariance_of
from magmatch.registration.index.map_index import MapIndex
from magmatch.registration.maps import as_map
from magmatch.registration.prepared.pose_prior import pose_prior
from magmatch.registration.prepared.prepared_map import PreparedMap, prepare
from magmatch.registration.result import RegistrationResult
from magmatch.registration.search.candidate import SearchResult
from magmatch.registration.search.invariant_search import invariant_search
from magmatch.registration.strategy import Pair, Weighed
from magmatch.registration.weigh.covariance import enclosing
from magmatch.registration.weigh.decoys import decoys
from magmatch.registration.weigh.evidence import PoseEvidence
from magmatch.registration.weigh.map_covariance import map_covariance
from magmatch.registration.weigh.rank import rank_poses

log = logging.getLogger(__name__)

MapPair = Pair[PreparedMap, PreparedMap]
WeighedMap = Weighed[PreparedMap, PreparedMap, PoseEvidence]


@dataclass(frozen=True, eq=False, slots=True)
class MapStrategy:
    """Fills `Strategy` for a target that a map was made of."""

    prepared: PreparedMap
    config: RegistrationConfig
    seed: int

    @classmethod
    def of(cls, target: Survey | FieldMap, config: RegistrationConfig, seed: int, clock: Clock) -> "MapStrategy":
        """Map the target, and evaluate all that a search asks of it."""
        with clock("maps"):
            target_map = as_map(target, config.field)
        with clock("prepare"):
            prepared = prepare(target_map, config.invariants.n_draws, np.random.default_rng(seed))
        return cls(prepared, config, seed)

    @property
    def target(self) -> FieldMap:
        """The target's map."""
        return self.prepared.field_map

    def pair(self, index: MapIndex, volume: float | None = None) -> MapPair:
        """Two prepared maps."""
        volume = index.base.raster.volume if volume is None else volume
        prior = pose_prior(self.config.prior, index.base.T_map_model, self.prepared.T_map_model, volume)
        return Pair(index.base, self.prepared, prior)

    def search(self, pair: MapPair) -> SearchResult:
        """Poses under which local frames and invariants agree."""
        rng = np.random.default_rng(self.seed)
        return invariant_search(pair.base, pair.target, pair.prior, self.config.invariants, rng)

    def refine_and_weigh(self, pair: MapPair, found: SearchResult) -> WeighedMap:
        """Refine against both maps; each cell of the target adds evidence for or against."""
        log.info("refining the best poses")
        starts = [c.T_base_target for c in found.candidates]
        ranked = rank_poses(pair.base, pair.target, starts, pair.prior, self.config, self.seed)
        return Weighed(pair, found, ranked)

    def search_decoys(self, weighed: WeighedMap) -> WeighedMap:
        """Search mirror images of the base, where the answer would be accepted and is weak enough to be chance."""
        is_clear = weighed.log_density >= self.config.decision.certain_log_evidence
        # A rough pose known beforehand leaves little to chance, and none is known in a mirror image.
        if is_clear or weighed.pair.prior.T_base_target is not None:
            return weighed
        if not self.decide(weighed).is_accepted:
            return weighed
        log.info("searching places that do not exist")
        reached = -np.inf
        for base, prior in decoys(weighed.pair.base, weighed.pair.prior):
            pair = Pair(base, weighed.pair.target, prior)
            # Evidence beside an estimated change is on another scale: like is compared with like.
            comparable = [
                e.log_evidence
                for e in self.refine_and_weigh(pair, self.search(pair)).ranked
                if e.is_beside_change == weighed.ranked[0].is_beside_change
            ]
            reached = max([reached, *comparable])
        return replace(weighed, decoy_evidence=reached)

    def decide(self, weighed: WeighedMap) -> RegistrationResult:
        """By the evidence of independent cells."""
        w, decision = weighed, self.config.decision
        return by_evidence(w.pair.base, w.pair.target, w.found, w.ranked, decision, w.lead, w.decoy_evidence)

    def settle(self, weighed: WeighedMap, answer: RegistrationResult) -> RegistrationResult:
        """Widen the covariance by what the maps do not know between their samples.

        Far from a map's samples its error is alike everywhere: the pose follows it, and no residual tells. Where
        residuals do tell of it, both say the same: the larger is taken, not the sum.
        """
        # Where a change was estimated, its covariance already covers this.
        if not answer.is_accepted or weighed.ranked[0].is_beside_change:
            return answer
        best, pair = weighed.ranked[0], weighed.pair
        assert best.covariance is not None  # it was accepted
        of_maps = map_covariance(pair.base, pair.target, best.pose, self.config.refinement, self.seed)
        whole = replace(best, covariance=enclosing(best.covariance, of_maps))
        return replace(answer, covariance=covariance_of(whole, pair.target))
