# SPDX-License-Identifier: BSD-3-Clause
"""The verb of this room: two surveys (or maps) in, one transform or a reasoned refusal out."""

import logging
from dataclasses import replace
from functools import partial

import numpy as np

from magmatch._version import __version__
from magmatch.data.survey import Survey
from magmatch.field.build import build_map
from magmatch.field.map import FieldMap
from magmatch.registration.both_sides import needs_both_sides, refine_from_both_sides
from magmatch.registration.calibrated import attempted, better_supported, calibrate
from magmatch.registration.clock import Stopwatch
from magmatch.registration.config import PRESETS, RegistrationConfig
from magmatch.registration.decide.answer import by_fitness
from magmatch.registration.decide.fitness import alignment_fitness
from magmatch.registration.index.map_index import MapIndex, index_base, prepare_base
from magmatch.registration.prepared.prepared_map import PreparedMap, prepare
from magmatch.registration.prepared.walk import choose_search
from magmatch.registration.published.keypoint_search import keypoint_search
from magmatch.registration.register_map import judge_map, search_map
from magmatch.registration.register_walk import WalkIndex, register_walk
from magmatch.registration.result import RegistrationResult
from magmatch.registration.serialization import describe_input
from magmatch.threads import side_by_side, single_threaded

log = logging.getLogger(__name__)

# Map of the base, the target as it was used, and the answer.
Found = tuple[FieldMap, Survey | FieldMap, RegistrationResult]


def register(
    base: Survey | FieldMap | MapIndex,
    target: Survey | FieldMap,
    config: RegistrationConfig | None = None,
    *,
    seed: int = 0,
) -> RegistrationResult:
    """Find the rigid transform between two magnetic surveys of one place, or say why there is none.

    Parameters
    ----------
    base, target : Survey or FieldMap
        Each in its own frame; surveys are mapped first. A base that serves many targets is best given as its
        `MapIndex`, which holds what else would be computed again for each.
    config : RegistrationConfig, optional
        Preset ``default`` unless given; ``PRESETS["paper"]`` is the published method.
    seed : int
        Same input, configuration and seed give the same answer bit for bit.

    Returns
    -------
    RegistrationResult
        ``T_base_target`` is None unless accepted; ``reason`` says which check decided.

    Raises
    ------
    SurveyError
        If a survey holds NaN, impossible values or too few samples.
    """
    return register_keeping_maps(base, target, config, seed=seed)[2]


@single_threaded
def register_keeping_maps(
    base: Survey | FieldMap | MapIndex,
    target: Survey | FieldMap,
    config: RegistrationConfig | None = None,
    *,
    seed: int = 0,
) -> tuple[FieldMap, Survey | FieldMap, RegistrationResult]:
    """Register, and hand on the maps that were made on the way: for pictures, or for the next registration.

    Parameters
    ----------
    base, target, config, seed
        As `register` says.

    Returns
    -------
    base_map : FieldMap
        As it was used: of the calibrated survey, where the result says so.
    target : Survey or FieldMap
        Likewise; a survey only where the answer needed no map of it.
    result : RegistrationResult
        What `register` gives.
    """
    config = config or PRESETS["default"]
    # A map of the target leaves samples out; a walk is compared with all that were given.
    clock, samples = Stopwatch(), survey_of(target)
    inputs = (describe_input(survey_of(base)), describe_input(samples))
    found = _registered(base, target, samples, config, seed, clock)
    if config.calibrate:
        found = _surer_when_calibrated(base, samples, found, config, seed, clock)
    base_map, used, answer = found
    return (
        base_map,
        used,
        replace(
            answer,
            seconds=clock.seconds(),
            config=config.model_dump(mode="json"),
            version=__version__,
            seed=seed,
            inputs=inputs,
        ),
    )


def _registered(
    base: Survey | FieldMap | MapIndex,
    target: Survey | FieldMap,
    samples: Survey,
    config: RegistrationConfig,
    seed: int,
    clock: Stopwatch,
) -> Found:
    """The answer for two surveys as they are."""
    if isinstance(base, Survey):
        # Both at once: a base that has to be mapped first leaves a core for the target.
        base, target = clock.time("maps", side_by_side, partial(as_map, config=config), (base, target))
    base_map = base.field_map if isinstance(base, MapIndex) else base
    if config.search == "keypoints" and config.decision.rule == "fitness":
        target = clock.time("maps", as_map, target, config)
        return base_map, target, register_by_keypoints(base_map, target, config, seed, clock)
    target, answer = register_by_field(base, target, samples, config, seed, clock)
    return base_map, target, answer


def _surer_when_calibrated(
    base: Survey | FieldMap | MapIndex,
    samples: Survey,
    found: Found,
    config: RegistrationConfig,
    seed: int,
    clock: Stopwatch,
) -> Found:
    """Where readings turn with their sensor, the answer for calibrated ones if that is the surer."""
    base_map, target, as_given = found
    asked = {"base": (base_map, survey_of(base))}
    # A walk that no map was made of is too short to tell.
    asked |= {"target": (target, samples)} if isinstance(target, FieldMap) else {}
    found_of = clock.time("calibrate", side_by_side, lambda side: calibrate(*asked[side]), asked)
    sides = {side: one for side, one in zip(asked, found_of, strict=True) if one is not None}
    if not sides:
        return found
    log.info("registering once more, calibrated")
    new_base: Survey | FieldMap | MapIndex = base_map if isinstance(base, Survey) else base
    if "base" in sides:
        new_base = sides["base"].survey
    if "target" in sides:
        samples = target = sides["target"].survey
    again = attempted(_registered, new_base, target, samples, config, seed, clock)
    if again is None:
        return found
    answer = better_supported(as_given, again[2], sides)
    return found if answer is as_given else (again[0], again[1], answer)


def register_by_field(
    base: FieldMap | MapIndex,
    target: Survey | FieldMap,
    samples: Survey,
    config: RegistrationConfig,
    seed: int,
    clock: Stopwatch,
) -> tuple[Survey | FieldMap, RegistrationResult]:
    """Compare the target with the base's field: as a walk where it is a line, else as a map; says which."""
    prepared = base.base if isinstance(base, MapIndex) else clock.time("prepare", prepare_base, base, config)
    search, as_walk = config.search, None
    if search == "auto":
        search = choose_search(samples, prepared.correlation_length)
    if search == "pairs":
        log.info("searching for the walk by pairs of points")
        walks = base.walks if isinstance(base, MapIndex) else clock.time("index", index_base, prepared, config)
        rng = np.random.default_rng(seed)
        as_walk = clock.time("walk", register_walk, walks, samples, config.walks, rng, config.prior)
        as_walk = settle_walk(walks, target, as_walk, config, seed, clock)
        if as_walk.is_accepted or config.search == "pairs":
            return target, as_walk
    # A line that turns and crosses itself may have the breadth that maps are compared by.
    target_map = clock.time("maps", as_map, target, config)
    answer = register_as_map(prepared, target_map, config, seed, clock)
    if as_walk is None or answer.is_accepted or (answer.probability or 0) > (as_walk.probability or 0):
        return target_map, answer
    return target, as_walk


def register_as_map(
    base: PreparedMap, target: FieldMap, config: RegistrationConfig, seed: int, clock: Stopwatch
) -> RegistrationResult:
    """Search, refine against the field, decide by the evidence of independent modes."""
    prepared = prepare_target(target, config, seed, clock)
    weighed = search_map(base, prepared, config, seed, clock, base.raster.volume)
    return clock.time("decide", judge_map, weighed, config, seed)


def settle_walk(
    walks: WalkIndex,
    target: Survey | FieldMap,
    answer: RegistrationResult,
    config: RegistrationConfig,
    seed: int,
    clock: Stopwatch,
) -> RegistrationResult:
    """Refine a walk's answer from both sides where the base alone cannot tell how sure it is."""
    if not needs_both_sides(walks, answer):
        return answer
    other_side = prepare_target(target, config, seed, clock)
    return clock.time("refine", refine_from_both_sides, walks.base, other_side, answer, config, seed)


def prepare_target(target: Survey | FieldMap, config: RegistrationConfig, seed: int, clock: Stopwatch) -> PreparedMap:
    """Map a target where it is none yet, and put it into the form that maps are compared in."""
    target_map = clock.time("maps", as_map, target, config)
    return clock.time("prepare", prepare, target_map, config.invariants.n_draws, np.random.default_rng(seed))


def register_by_keypoints(
    base_map: FieldMap, target_map: FieldMap, config: RegistrationConfig, seed: int, clock: Stopwatch
) -> RegistrationResult:
    """Keypoints, HOV, nearest neighbours, vector MSAC and the fitness check, as published."""
    rng = np.random.default_rng(seed)
    found = clock.time("search", keypoint_search, base_map, target_map, config.keypoints, rng)
    best = found.candidates[0].T_base_target if found.candidates else None
    fitness = clock.time("decide", alignment_fitness, base_map, target_map.survey, best) if best is not None else None
    return by_fitness(found, fitness, config.decision)


def survey_of(survey_or_map: Survey | FieldMap | MapIndex) -> Survey:
    """Samples of a survey, or those that a map was made from."""
    if isinstance(survey_or_map, MapIndex):
        return survey_or_map.field_map.survey
    return survey_or_map.survey if isinstance(survey_or_map, FieldMap) else survey_or_map


def as_map(survey_or_map: Survey | FieldMap, config: RegistrationConfig) -> FieldMap:
    """Map a survey; a map is taken as it is."""
    if isinstance(survey_or_map, FieldMap):
        return survey_or_map
    return build_map(survey_or_map, config.field)
