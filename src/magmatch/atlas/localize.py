# SPDX-License-Identifier: BSD-3-Clause
"""The verb of this room: an atlas and a target in, the map that holds it and the pose in that map out."""

import logging
from collections.abc import Mapping
from dataclasses import replace

import numpy as np

from magmatch._version import __version__
from magmatch.atlas.atlas import Atlas, AtlasEntry
from magmatch.atlas.retrieval import count_agreement, count_votes
from magmatch.data.survey import Survey
from magmatch.field.map import FieldMap
from magmatch.registration.calibrated import attempted, better_supported, calibrate
from magmatch.registration.clock import Stopwatch
from magmatch.registration.prepared.walk import choose_search, walk_of
from magmatch.registration.register import prepare_target, settle_walk, survey_of
from magmatch.registration.register_map import WeighedMap, judge_map, search_map
from magmatch.registration.register_walk import WeighedWalk, judge_walk, search_walk
from magmatch.registration.result import RegistrationResult
from magmatch.registration.serialization import describe_input
from magmatch.threads import single_threaded
from magmatch.typing import Scalars

log = logging.getLogger(__name__)

# Maps that are searched in full: at least and at most so many, and those with this share of the most votes.
MIN_SHORTLIST, MAX_SHORTLIST, SHORTLIST_SHARE = 4, 8, 0.5


def localize(atlas: Atlas, target: Survey | FieldMap, *, seed: int = 0) -> RegistrationResult:
    """Find the map that holds a survey, and the pose in it; or say why there is none.

    Parameters
    ----------
    atlas : Atlas
        From `open_atlas`.
    target : Survey or FieldMap
    seed : int
        Same atlas, target and seed give the same answer bit for bit.

    Returns
    -------
    RegistrationResult
        ``base`` names the map; alternatives name theirs. An answer is accepted only where no pose in any map comes
        near it, and it pays for a search through all of them.
    """
    return localize_keeping_map(atlas, target, seed=seed)[1]


@single_threaded
def localize_keeping_map(
    atlas: Atlas, target: Survey | FieldMap, *, seed: int = 0
) -> tuple[Survey | FieldMap, RegistrationResult]:
    """Find the map that holds a survey, and hand on the target as it was used: for pictures.

    Parameters
    ----------
    atlas, target, seed
        As `localize` says.

    Returns
    -------
    target : Survey or FieldMap
        A survey only where the answer needed no map of it.
    result : RegistrationResult
        What `localize` gives.
    """
    clock, config, survey = Stopwatch(), atlas.config, survey_of(target)
    length = float(np.median([entry.table.length for entry in atlas.entries]))
    search = choose_search(survey, length) if config.search == "auto" else config.search
    if search == "pairs":
        answer = localize_walk(atlas, survey, seed, clock)
    else:
        target, answer = localize_map(atlas, target, survey, seed, clock)
    found = (atlas.load(entry).field_map.survey for entry in atlas.entries if entry.name == answer.base)
    answer = replace(
        answer,
        seconds=clock.seconds(),
        config=config.model_dump(mode="json"),
        version=__version__,
        seed=seed,
        inputs=tuple(describe_input(s) for s in (*found, survey)),
    )
    return target, answer


def localize_walk(atlas: Atlas, survey: Survey, seed: int, clock: Stopwatch) -> RegistrationResult:
    """Ask all maps for votes, search the likeliest in full, judge the best pose of all."""
    config = atlas.config
    log.info("asking %d maps", len(atlas.entries))
    tables = [entry.table for entry in atlas.entries]
    votes = clock.time("votes", count_votes, tables, survey, config.walks.search, seed)

    likely = shortlist(atlas.entries, votes)
    # The same bins for all: only then can their densities be compared.
    walk = walk_of(survey, float(np.median([entry.table.length for entry in likely])))

    def search(entry: AtlasEntry) -> WeighedWalk:
        index, rng = clock.time("load", atlas.load, entry), np.random.default_rng(seed)
        log.info("searching %s", entry.name)
        return clock.time("walk", search_walk, index.walks, walk, config.walks, rng, config.prior, atlas.volume)

    weighed = {entry: search(entry) for entry in likely}
    leads = _leads(weighed)
    answers = {entry: judge_walk(weighed[entry], config.walks, leads[entry]) for entry in leads}
    first, answer = next(iter(answers.items()))
    answers[first] = settle_walk(weighed[first].index, survey, answer, config, seed, clock)
    return _with_alternatives(answers)


def localize_map(
    atlas: Atlas, target: Survey | FieldMap, survey: Survey, seed: int, clock: Stopwatch
) -> tuple[FieldMap, RegistrationResult]:
    """The surer answer for a target as it is, and calibrated where its readings turn with its sensor."""
    found = target_map, answer = _localize_map(atlas, target, seed, clock)
    side = clock.time("calibrate", calibrate, target_map, survey) if atlas.config.calibrate else None
    if side is None:
        return found
    log.info("searching once more, calibrated")
    again = attempted(_localize_map, atlas, side.survey, seed, clock)
    if again is None:
        return found
    better = better_supported(answer, again[1], {"target": side})
    return found if better is answer else (again[0], better)


def _localize_map(
    atlas: Atlas, target: Survey | FieldMap, seed: int, clock: Stopwatch
) -> tuple[FieldMap, RegistrationResult]:
    """Score a few poses in every map, search the likeliest in full, judge the best pose of all."""
    config = atlas.config
    prepared = prepare_target(target, config, seed, clock)
    log.info("asking %d maps", len(atlas.entries))
    bases = (clock.time("load", atlas.load, entry).base for entry in atlas.entries)
    votes = clock.time("votes", count_agreement, bases, prepared, config, seed)

    def search(entry: AtlasEntry) -> WeighedMap:
        log.info("searching %s", entry.name)
        base = clock.time("load", atlas.load, entry).base
        return search_map(base, prepared, config, seed, clock, atlas.volume)

    weighed = {entry: search(entry) for entry in shortlist(atlas.entries, votes)}
    leads = _leads(weighed)
    answers = {entry: judge_map(weighed[entry], config, seed, leads[entry]) for entry in leads}
    return prepared.field_map, _with_alternatives(answers)


def shortlist(entries: tuple[AtlasEntry, ...], votes: Scalars) -> list[AtlasEntry]:
    """Maps worth a full search, likeliest first: a few always, and those nearly as likely as the first."""
    order = np.argsort(-votes, kind="stable")[:MAX_SHORTLIST]
    enough = SHORTLIST_SHARE * votes[order[0]]
    return [entries[k] for n, k in enumerate(order) if n < MIN_SHORTLIST or votes[k] >= enough]


def _leads(weighed: Mapping[AtlasEntry, WeighedWalk] | Mapping[AtlasEntry, WeighedMap]) -> dict[AtlasEntry, float]:
    """Lead of each map's best pose over that of any other map, best first."""
    ranked = sorted(weighed, key=lambda entry: -weighed[entry].log_density)
    first, *others = (weighed[entry].log_density for entry in ranked)
    leads = {entry: weighed[entry].log_density - first for entry in ranked}
    return leads | {ranked[0]: first - others[0] if others and np.isfinite(others[0]) else np.inf}


def _with_alternatives(judged: dict[AtlasEntry, RegistrationResult]) -> RegistrationResult:
    """State the answer of the best map, and beside a refusal the best pose of each other map; best first."""
    (best, answer), *others = judged.items()
    if answer.is_accepted:
        return replace(answer, base=best.name)
    elsewhere = tuple(replace(r.alternatives[0], base=entry.name) for entry, r in others if r.alternatives)
    return replace(
        answer, base=best.name if answer.alternatives else None, alternatives=answer.alternatives + elsewhere
    )
