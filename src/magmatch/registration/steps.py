# SPDX-License-Identifier: BSD-3-Clause
"""The algorithm: map, then for each strategy prepare, search, refine and weigh, try decoys, decide, settle."""

from magmatch.data.survey import Survey
from magmatch.field.map import FieldMap
from magmatch.registration.clock import Clock
from magmatch.registration.config import RegistrationConfig
from magmatch.registration.index.map_index import MapIndex, prepare_index
from magmatch.registration.maps import as_map, map_base
from magmatch.registration.published.method import register_published
from magmatch.registration.result import RegistrationResult
from magmatch.registration.strategies import strategies

Target = Survey | FieldMap
Base = Target | MapIndex
# Map of the base, the target as it was used, and the answer.
Outcome = tuple[FieldMap, Target, RegistrationResult]


def register_once(
    base: Base, target: Target, samples: Survey, config: RegistrationConfig, seed: int, clock: Clock
) -> Outcome:
    """The answer without calibrating sensors; a walk is compared with all its samples, mapped or not."""
    with clock("maps"):
        base, target = map_base(base, target, config.field)
    # The published method has steps of its own.
    if config.search == "keypoints":
        with clock("maps"):
            target_map = as_map(target, config.field)
        base_map = base.field_map if isinstance(base, MapIndex) else base
        return base_map, target_map, register_published(base_map, target_map, config.keypoints, seed, clock)
    with clock("prepare"):
        index = prepare_index(base, config)
    tried: list[tuple[Target, RegistrationResult]] = []
    for strategy in strategies(index.length, target, samples, config, seed, clock):
        with clock("prepare"):
            pair = strategy.pair(index)
        with clock("search"):
            candidates = strategy.search(pair)
        with clock("refine"):
            weighed = strategy.refine_and_weigh(pair, candidates)
        with clock("decoys"):
            weighed = strategy.search_decoys(weighed)
        with clock("decide"):
            answer = strategy.decide(weighed)
        with clock("settle"):
            answer = strategy.settle(weighed, answer)
        tried.append((strategy.target, answer))
        if answer.is_accepted:
            break
    # None accepted: the more probable refusal, the first where both are equal.
    used, answer = max(tried, key=lambda one: (one[1].is_accepted, one[1].probability or 0))
    return index.field_map, used, answer
