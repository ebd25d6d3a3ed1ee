# SPDX-License-Identifier: BSD-3-Clause
"""A walk or a map found in the maps of an atlas: all are asked for votes, the most likely are searched."""

from functools import cache

import numpy as np

from magmatch.atlas.atlas import Atlas
from magmatch.atlas.best_of import best_of
from magmatch.atlas.retrieval import count_agreement, count_votes, shortlist
from magmatch.data.survey import Survey
from magmatch.field.map import FieldMap
from magmatch.progress import tell
from magmatch.registration.clock import Clock
from magmatch.registration.map_strategy import MapStrategy
from magmatch.registration.result import RegistrationResult
from magmatch.registration.sensor_calibration import attempted, better_supported, calibrate
from magmatch.registration.walk_strategy import WalkStrategy


def find_walk(atlas: Atlas, target: Survey | FieldMap, survey: Survey, seed: int, clock: Clock) -> RegistrationResult:
    """Collect votes for all maps, then compare the most likely ones with the walk."""
    tell(f"asking {len(atlas.entries)} maps")
    with clock("votes"):
        votes = count_votes([entry.table for entry in atlas.entries], survey, atlas.config.walks.search, seed)
    likely = [atlas.entries[k] for k in shortlist(votes)]
    # The same bins for all maps, so that none is judged by more of them.
    length = float(np.median([entry.table.length for entry in likely]))
    mapped = cache(lambda: MapStrategy.of(target, atlas.config, seed, clock))
    return best_of(atlas, likely, WalkStrategy(target, survey, atlas.config, seed, mapped, length), clock)


def find_map(
    atlas: Atlas, target: Survey | FieldMap, survey: Survey, seed: int, clock: Clock, *, can_calibrate: bool
) -> tuple[FieldMap, RegistrationResult]:
    """The better supported answer: for a target as it is, and calibrated where its readings turn with its sensor."""
    found = _compare_map(atlas, target, seed, clock)
    if not (atlas.config.calibrate and can_calibrate):
        return found
    with clock("calibrate"):
        calibrated = calibrate(found[0], survey)
    if calibrated is None:
        return found
    tell("searching once more, calibrated")
    again = attempted(_compare_map, atlas, calibrated.survey, seed, clock)
    return better_supported(found, again, {"target": calibrated})


def _compare_map(
    atlas: Atlas, target: Survey | FieldMap, seed: int, clock: Clock
) -> tuple[FieldMap, RegistrationResult]:
    """Score a few poses in every map, then compare the most likely maps with the target's map."""
    strategy = MapStrategy.of(target, atlas.config, seed, clock)
    tell(f"asking {len(atlas.entries)} maps")
    with clock("votes"):
        bases = (atlas.load(entry).base for entry in atlas.entries)
        votes = count_agreement(bases, strategy.prepared, seed)
    return strategy.target, best_of(atlas, [atlas.entries[k] for k in shortlist(votes)], strategy, clock)
