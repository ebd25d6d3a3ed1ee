# SPDX-License-Identifier: BSD-3-Clause
"""Poses of a walk weighed as those of two maps, whose errors beside their own paths have opposite signs."""

from dataclasses import replace
from typing import Any

from magmatch.progress import tell
from magmatch.registration.index.walk_index import WalkIndex
from magmatch.registration.map_strategy import MapStrategy
from magmatch.registration.prepared.walk import Walk
from magmatch.registration.search.candidate import SearchResult
from magmatch.registration.strategy import Pair, Weighed, pair_maps
from magmatch.registration.weigh.refine_and_weigh_walk import LineEvidence


def weigh_as_maps(
    mapped: MapStrategy, pair: Pair[WalkIndex, Walk], found: SearchResult, ranked: list[LineEvidence]
) -> Weighed[Any, Any, Any]:
    """Refine and weigh them from both sides: the residuals along this base's path cannot be learned."""
    tell("weighing the walk's poses from both sides")
    as_maps = pair_maps(pair.base.base, mapped.prepared, mapped.config.prior, pair.prior.volume)
    to_model = pair.T_target_model.inv() * as_maps.T_target_model
    poses = tuple(e.T_base_target * to_model for e in ranked)
    return mapped.refine_and_weigh(as_maps, replace(found, poses=poses))
