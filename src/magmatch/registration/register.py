# SPDX-License-Identifier: BSD-3-Clause
"""The verb of this room: two surveys (or maps) in, one transform or a reasoned refusal out."""

import logging
from dataclasses import replace

import numpy as np
from scipy.spatial.transform import RigidTransform

from magmatch import __version__
from magmatch.data.survey import Survey
from magmatch.field.build import build_map
from magmatch.field.map import FieldMap
from magmatch.registration.answer import by_evidence, by_fitness
from magmatch.registration.candidate import SearchResult
from magmatch.registration.config import PRESETS, RegistrationConfig
from magmatch.registration.evidence import PoseEvidence, unrelated_field, weigh_pose
from magmatch.registration.fitness import alignment_fitness
from magmatch.registration.invariant_search import invariant_search
from magmatch.registration.keypoint_search import keypoint_search
from magmatch.registration.prepared import PreparedMap, prepare
from magmatch.registration.refinement import refine
from magmatch.registration.register_walk import index_walks, register_walk
from magmatch.registration.result import RegistrationResult
from magmatch.registration.sensors import levels_to_try
from magmatch.registration.serialization import describe_input
from magmatch.registration.stopwatch import Stopwatch
from magmatch.registration.walk import choose_search, field_length
from magmatch.threads import single_threaded

log = logging.getLogger(__name__)


@single_threaded
def register(
    base: Survey | FieldMap,
    target: Survey | FieldMap,
    config: RegistrationConfig | None = None,
    *,
    seed: int = 0,
) -> RegistrationResult:
    """Find the rigid transform between two magnetic surveys of one place, or say why there is none.

    Parameters
    ----------
    base, target : Survey or FieldMap
        Each in its own frame; surveys are mapped first.
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
    config = config or PRESETS["default"]
    clock = Stopwatch()
    base_map = clock.time("base map", as_map, base, config)
    if config.search == "keypoints" and config.decision.rule == "fitness":
        target_map = clock.time("target map", as_map, target, config)
        answer = register_by_keypoints(base_map, target_map, config, seed, clock)
    else:
        answer = register_by_field(base_map, target, config, seed, clock)
    return replace(
        answer,
        seconds=clock.seconds(),
        config=config.model_dump(mode="json"),
        version=__version__,
        seed=seed,
        inputs=(describe_input(base_map.survey), describe_input(_survey(target))),
    )


def register_by_field(
    base_map: FieldMap, target: Survey | FieldMap, config: RegistrationConfig, seed: int, clock: Stopwatch
) -> RegistrationResult:
    """Compare the target with the base's field: as a walk where it is a line, as a map otherwise."""
    base = clock.time("prepare", prepare, base_map, config.invariants.n_draws, np.random.default_rng(seed))
    survey, search = _survey(target), config.search
    if search == "auto":
        search = choose_search(survey, field_length(base))
    if search == "pairs":
        answer = register_as_walk(base, survey, config, seed, clock)
        if answer.is_accepted or config.search == "pairs":
            return answer
    return register_as_map(base, target, config, seed, clock)


def register_as_walk(
    base: PreparedMap, survey: Survey, config: RegistrationConfig, seed: int, clock: Stopwatch
) -> RegistrationResult:
    """Pairs of points, least squares along the path, decide by the walk's evidence."""
    rng = np.random.default_rng(seed)
    log.info("searching for the walk by pairs of points")
    index = clock.time("index", index_walks, base, config.walks, rng)
    return clock.time("walk", register_walk, index, survey, config.walks, rng)


def register_as_map(
    base: PreparedMap, target: Survey | FieldMap, config: RegistrationConfig, seed: int, clock: Stopwatch
) -> RegistrationResult:
    """Search, refine against the field, decide by the evidence of independent modes."""
    rng = np.random.default_rng(seed)
    target_map = clock.time("target map", as_map, target, config)
    prepared = clock.time("prepare", prepare, target_map, config.invariants.n_draws, rng)
    found = clock.time("search", _search, base, prepared, config, rng)
    log.info("refining the best poses")
    ranked = clock.time("refine", _refine_and_rank, base, prepared, found, config, seed)
    return clock.time("decide", by_evidence, base, prepared, found, ranked, config.decision)


def register_by_keypoints(
    base_map: FieldMap, target_map: FieldMap, config: RegistrationConfig, seed: int, clock: Stopwatch
) -> RegistrationResult:
    """Keypoints, HOV, nearest neighbours, vector MSAC and the fitness check, as published."""
    rng = np.random.default_rng(seed)
    found = clock.time("search", keypoint_search, base_map, target_map, config.keypoints, rng)
    best = found.candidates[0].T_base_target if found.candidates else None
    fitness = clock.time("decide", alignment_fitness, base_map, target_map.survey, best) if best is not None else None
    return by_fitness(found, fitness, config.decision)


def _survey(survey_or_map: Survey | FieldMap) -> Survey:
    return survey_or_map.survey if isinstance(survey_or_map, FieldMap) else survey_or_map


def as_map(survey_or_map: Survey | FieldMap, config: RegistrationConfig) -> FieldMap:
    """Map a survey; a map is taken as it is."""
    if isinstance(survey_or_map, FieldMap):
        return survey_or_map
    return build_map(survey_or_map, config.field)


def _search(
    base: PreparedMap, target: PreparedMap, config: RegistrationConfig, rng: np.random.Generator
) -> SearchResult:
    """Poses in model frames, whichever search is configured."""
    if config.search != "keypoints":
        return invariant_search(base, target, config.invariants, rng)
    found = keypoint_search(base.field_map, target.field_map, config.keypoints, rng)
    to_model = base.T_map_model.inv()
    candidates = tuple(
        replace(c, T_base_target=to_model * c.T_base_target * target.T_map_model) for c in found.candidates
    )
    return replace(found, candidates=candidates)


def _refine_and_rank(
    base: PreparedMap, target: PreparedMap, found: SearchResult, config: RegistrationConfig, seed: int
) -> list[PoseEvidence]:
    """Refine the best candidates and order them by their evidence."""
    starts: list[RigidTransform] = [c.T_base_target for c in found.candidates[: config.refinement.n_candidates]]
    unrelated = unrelated_field(base, target)
    tightest, *wider = levels_to_try(config.refinement.sensor)

    def weigh(start: RigidTransform, level: int) -> PoseEvidence:
        pose = refine(base, target, start, config.refinement, np.random.default_rng(seed), level)
        return weigh_pose(base, target, pose, unrelated)

    ranked = sorted((weigh(start, tightest) for start in starts), key=lambda e: -e.log_evidence)
    for level in wider if ranked else ():
        best = weigh(ranked[0].pose.T_base_target, level)
        if best.log_evidence > ranked[0].log_evidence + config.refinement.sensor.min_gain:
            ranked[0] = best
    return ranked
