# SPDX-License-Identifier: BSD-3-Clause
"""The target as a walk: pairs of points find poses, least squares along the path refines and weighs them."""

import logging
from dataclasses import dataclass

import numpy as np

from magmatch.data.survey import Survey
from magmatch.field.map import FieldMap
from magmatch.registration.both_sides import needs_both_sides, refine_from_both_sides
from magmatch.registration.clock import Clock
from magmatch.registration.config import RegistrationConfig
from magmatch.registration.decide.walk_answer import by_line_evidence
from magmatch.registration.index.map_index import MapIndex
from magmatch.registration.index.walk_index import WalkIndex
from magmatch.registration.map_strategy import MapStrategy
from magmatch.registration.prepared.pose_prior import pose_prior
from magmatch.registration.prepared.walk import Walk, walk_of
from magmatch.registration.result import RegistrationResult
from magmatch.registration.search.candidate import SearchResult
from magmatch.registration.search.pair_search import pair_search
from magmatch.registration.strategy import Pair, Weighed
from magmatch.registration.weigh.line_evidence import LineEvidence, weigh_walk

log = logging.getLogger(__name__)

WalkPair = Pair[WalkIndex, Walk]
WeighedWalk = Weighed[WalkIndex, Walk, LineEvidence]


@dataclass(frozen=True, eq=False, slots=True)
class WalkStrategy:
    """Fills `Strategy` for a line of samples, in the order they were taken."""

    target: Survey | FieldMap
    # All that were given: a map leaves out what contradicts the rest.
    samples: Survey
    config: RegistrationConfig
    seed: int
    clock: Clock
    # Correlation length (m) to bin by, the base's by default: only with the same bins can bases be compared.
    length: float | None = None

    def pair(self, index: MapIndex, volume: float | None = None) -> WalkPair:
        """The base's pairs of points, and the walk in bins."""
        walks = index.walks
        walk = walk_of(self.samples, self.length or walks.length)
        volume = index.base.raster.volume if volume is None else volume
        return Pair(walks, walk, pose_prior(self.config.prior, index.base.T_map_model, walk.T_survey_walk, volume))

    def search(self, pair: WalkPair) -> SearchResult:
        """Poses under which pairs of points agree."""
        log.info("searching for the walk by pairs of points")
        rng = np.random.default_rng(self.seed)
        return pair_search(pair.base.base, pair.base.table, pair.target, pair.prior, self.config.walks.search, rng)

    def refine_and_weigh(self, pair: WalkPair, found: SearchResult) -> WeighedWalk:
        """Generalised least squares, with residuals as this base's own stretches show them."""
        starts, walks = [c.T_base_target for c in found.candidates], pair.base
        config = self.config.walks.evidence
        ranked = weigh_walk(walks.base, pair.target, starts, walks.noise, walks.length, pair.prior, config)
        return Weighed(pair, found, ranked)

    def search_decoys(self, weighed: WeighedWalk) -> WeighedWalk:
        """None are searched: the covariance of the base's left-out stretches is learned, not assumed."""
        return weighed

    def decide(self, weighed: WeighedWalk) -> RegistrationResult:
        """By the evidence along the path."""
        w, walks, config = weighed, weighed.pair.base, self.config.walks.decision
        return by_line_evidence(walks.base, w.pair.target, w.found, w.ranked, walks.length, config, w.lead)

    def settle(self, weighed: WeighedWalk, answer: RegistrationResult) -> RegistrationResult:
        """Refine from both sides where the base alone cannot tell how sure the pose is."""
        if not needs_both_sides(weighed.pair.base, answer):
            return answer
        mapped = MapStrategy.of(self.target, self.config, self.seed, self.clock)
        return refine_from_both_sides(weighed.pair.base.base, mapped.prepared, answer, self.config, self.seed)
