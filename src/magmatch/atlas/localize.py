# SPDX-License-Identifier: BSD-3-Clause
"""`localize` for an atlas: the map that contains a target, and the pose in that map."""

from collections.abc import Mapping
from dataclasses import replace
from functools import cache
from typing import Any

import numpy as np

from magmatch.arguments import expect_kind, whole_number_of
from magmatch.atlas.atlas import Atlas, AtlasEntry
from magmatch.atlas.retrieval import count_agreement, count_votes
from magmatch.data.diagnoses import warn
from magmatch.data.survey import Survey
from magmatch.field.map import FieldMap
from magmatch.progress import Progress, followed, tell
from magmatch.registration.advice import with_advice
from magmatch.registration.clock import Clock
from magmatch.registration.map_strategy import MapStrategy
from magmatch.registration.maps import require_target, survey_of
from magmatch.registration.prepared.walk import choose_search
from magmatch.registration.provenance import stamped
from magmatch.registration.result import RegistrationResult
from magmatch.registration.sensor_calibration import attempted, better_supported, calibrate
from magmatch.registration.steps import settle_and_decide
from magmatch.registration.strategy import Strategy, Weighed
from magmatch.registration.walk_strategy import WalkStrategy
from magmatch.threads import one_blas_thread
from magmatch.typing import Scalars

# Maps that are searched in full: at least and at most so many, and those with this share of the most votes.
MIN_SHORTLIST, MAX_SHORTLIST, SHORTLIST_SHARE = 4, 8, 0.5


def localize(
    atlas: Atlas, target: Survey | FieldMap, *, seed: int = 0, progress: Progress | None = None
) -> RegistrationResult:
    """Find the map that holds a survey, and the pose in it; or say why there is none.

    ``base`` of the result names the map; alternatives name theirs. An answer is accepted only if no pose in any map
    comes close to it, with the search penalty for all maps. The same seed gives the same bits.
    """
    with followed(progress):
        return localize_keeping_map(atlas, target, seed=seed)[1]


def localize_keeping_map(
    atlas: Atlas, target: Survey | FieldMap, *, seed: int = 0
) -> tuple[Survey | FieldMap, RegistrationResult]:
    """As `localize`; also gives the target as used, for pictures: a survey if the answer needed no map of it."""
    expect_kind(atlas, "atlas", (Atlas,), "open_atlas(folder) opens a folder of maps")
    require_target(target)
    whole_number_of(seed, "seed")
    clock, config, survey = Clock(), atlas.config, survey_of(target)
    diagnoses = warn([survey])
    length = float(np.median([entry.table.length for entry in atlas.entries]))
    search = choose_search(survey, length) if config.search == "auto" else config.search
    with one_blas_thread():
        if search == "pairs":
            used, answer = target, _localize_walk(atlas, target, survey, seed, clock)
        else:
            can_help = not any(one.is_of_frames for one in diagnoses)
            used, answer = _localize_map(atlas, target, survey, seed, clock, can_calibrate=can_help)
    found = [atlas.load(entry).field_map.survey for entry in atlas.entries if entry.name == answer.base]
    surveys = dict(zip(("base", "target") if found else ("target",), (*found, survey), strict=True))
    answer = with_advice(answer, surveys, config.prior)
    return used, stamped(answer, (*found, survey), config, seed, clock)


def _localize_walk(
    atlas: Atlas, target: Survey | FieldMap, survey: Survey, seed: int, clock: Clock
) -> RegistrationResult:
    """Collect votes for all maps, then compare the most likely ones with the walk."""
    tell(f"asking {len(atlas.entries)} maps")
    with clock("votes"):
        votes = count_votes([entry.table for entry in atlas.entries], survey, atlas.config.walks.search, seed)
    likely = shortlist(atlas.entries, votes)
    # The same bins for all maps, so that none is judged by more of them.
    length = float(np.median([entry.table.length for entry in likely]))
    mapped = cache(lambda: MapStrategy.of(target, atlas.config, seed, clock))
    return _best_of(atlas, likely, WalkStrategy(target, survey, atlas.config, seed, mapped, length), clock)


def _localize_map(
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
    return strategy.target, _best_of(atlas, shortlist(atlas.entries, votes), strategy, clock)


def _best_of(
    atlas: Atlas, likely: list[AtlasEntry], strategy: Strategy[Any, Any, Any], clock: Clock
) -> RegistrationResult:
    """Weigh poses in each map and decide on the best of all, with the search penalty for the whole atlas."""
    weighed = {}
    for k, entry in enumerate(likely):
        tell(f"searching {entry.name}", k / len(likely))
        with clock("load"):
            base = atlas.load(entry)
        with clock("prepare"):
            pair = strategy.pair(base, atlas.volume)
        with clock("search"):
            found = strategy.search(pair)
        with clock("refine"):
            weighed[entry] = strategy.refine_and_weigh(pair, found)
    answers = {}
    for entry, elsewhere in _best_elsewhere(weighed).items():
        best = replace(weighed[entry], elsewhere=elsewhere)
        answers[entry] = settle_and_decide(best, atlas.config.decision, clock)
    return _with_alternatives(answers)


def shortlist(entries: tuple[AtlasEntry, ...], votes: Scalars) -> list[AtlasEntry]:
    """Maps for a full search, most likely first: always a few, and those nearly as likely as the first."""
    order = np.argsort(-votes, kind="stable")[:MAX_SHORTLIST]
    enough = SHORTLIST_SHARE * votes[order[0]]
    return [entries[k] for n, k in enumerate(order) if n < MIN_SHORTLIST or votes[k] >= enough]


def _best_elsewhere(weighed: Mapping[AtlasEntry, Weighed[Any, Any, Any]]) -> dict[AtlasEntry, float]:
    """Log odds of the best pose in any other map; the map of the best pose first."""
    odds = {entry: one.best_log_odds for entry, one in weighed.items()}
    ranked = sorted(odds, key=lambda entry: -odds[entry])
    return {entry: max((odds[other] for other in ranked if other is not entry), default=-np.inf) for entry in ranked}


def _with_alternatives(judged: dict[AtlasEntry, RegistrationResult]) -> RegistrationResult:
    """State the answer of the best map and, for a refusal, the best pose of each other map; best first."""
    (best, answer), *others = judged.items()
    if answer.is_accepted:
        return replace(answer, base=best.name)
    elsewhere = tuple(replace(r.alternatives[0], base=entry.name) for entry, r in others if r.alternatives)
    return replace(
        answer, base=best.name if answer.alternatives else None, alternatives=answer.alternatives + elsewhere
    )
