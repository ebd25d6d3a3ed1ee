# SPDX-License-Identifier: BSD-3-Clause
"""The target as a walk: poses are found by pairs of points, refined and weighed by least squares along the path."""

from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from magmatch.data.survey import Survey
from magmatch.estimation.pose_prior import pose_prior
from magmatch.estimation.posterior import in_order
from magmatch.estimation.walk import Walk, walk_of
from magmatch.field.map import FieldMap
from magmatch.registration.config import RegistrationConfig
from magmatch.registration.decide.estimate import Estimate, Pair
from magmatch.registration.decide.support import Support, support_of_walk
from magmatch.registration.index.atlas import Bases
from magmatch.registration.index.map_index import MapIndex, WalkIndex
from magmatch.registration.prepared.prepared_map import height_range
from magmatch.registration.search.candidate import SearchResult
from magmatch.registration.search.pair_search import pair_search
from magmatch.registration.weigh.bend import Bend, bend_of_walk
from magmatch.registration.weigh.bending_walk import BendingWalk, worth_bending
from magmatch.registration.weigh.refine_and_weigh_walk import LineEvidence, inside_base, weigh_walk

WalkPair = Pair[WalkIndex, Walk]


@dataclass(frozen=True, eq=False, slots=True)
class WalkStrategy:
    """The steps for a line of samples, in the order they were taken; `MapStrategy` says what each does."""

    target: Survey | FieldMap
    # All samples given: a map leaves out those that contradict the rest.
    samples: Survey
    config: RegistrationConfig
    seed: int

    def likely(self, bases: Bases) -> list[Any]:
        """Those in which most pairs of points agree on one pose."""
        return bases.likely_for_walk(self.samples, self.seed)

    def pair(self, index: MapIndex, volume: float | None = None, length: float | None = None) -> WalkPair:
        """The base's pairs of points, and the walk in bins.

        They are by the length (m) that all bases share, so that none is judged by more bins.
        """
        # The map's sensors lost their biases, this walk's has its own: on a short walk a constant.
        noise = index.walks.noise
        constant_sd = float(np.hypot(noise.constant_sd, index.field_map.bias_spread))
        walks = replace(index.walks, noise=replace(noise, constant_sd=constant_sd))
        walk = walk_of(self.samples, length or index.length)
        frames = index.base.T_map_model, walk.T_survey_walk
        prior = pose_prior(self.config.prior, *frames, volume or index.volume, height_range(index.base))
        prior = inside_base(prior, index.base, walk)
        return Pair(walks, walk, prior, walks.length, *frames)

    def search(self, pair: WalkPair) -> SearchResult:
        """Poses under which pairs of points agree."""
        rng = np.random.default_rng(self.seed)
        return pair_search(pair.base.base, pair.base.table, pair.target, pair.prior, rng)

    def refine_and_weigh(self, pair: WalkPair, found: SearchResult, ahead: float | None = None) -> list[LineEvidence]:
        """Generalised least squares, with what this base's own stretches show of residuals, and with more drift.

        In one of many maps a walk is bent only where it could match beside the best pose in others, which is
        ``ahead`` of unrelated surveys by so many nats.
        """
        base, noise = pair.base.base, pair.base.noise
        ranked = weigh_walk(base, pair.target, found.poses, noise, pair.prior)
        if not ranked or (noise.is_learned and ranked[0].is_explained):
            return ranked  # nothing is left for more drift to explain
        rest = list[LineEvidence]()
        if ahead is not None:
            ranked, rest = worth_bending(base, pair.target, ranked, noise, pair.prior, ahead)
        bent = BendingWalk.of(base, pair.target, noise, pair.prior).weigh(ranked) if ranked else []
        return in_order([*bent, *rest]) if rest else bent

    def state(self, pair: WalkPair, pose: LineEvidence) -> tuple[Estimate, Support]:
        """State a pose with the covariance from the residuals along the path."""
        # The base's own stretches show how poses drift, but no error of the walk's frame as a whole; the drift of a
        # walk that bends is that of its frame, too.
        pose_sd = 0.0 if pose.bends else pair.target.pose_sd
        covariance = pose.covariance + np.diag([0.0] * 3 + [pose_sd**2] * 3)
        estimate = pair.estimate(replace(pose, covariance=covariance))
        return estimate, support_of_walk(pair.target, pose, estimate.T_base_target)

    # Along a path, nothing remains to be widened.
    settle = state

    def bend(self, pair: WalkPair, pose: LineEvidence) -> Bend | None:
        """The difference between the halves' poses along the path."""
        if pose.bends:
            return None  # it is part of its covariance
        walks, T = pair.base, pose.T_base_target
        return bend_of_walk(walks.base, pair.target, T, walks.noise, pair.prior)
