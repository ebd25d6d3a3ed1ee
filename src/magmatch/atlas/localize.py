# SPDX-License-Identifier: BSD-3-Clause
"""`localize` for an atlas: the map that contains a target, and the pose in that map."""

import numpy as np

from magmatch.arguments import expect_kind, whole_number_of
from magmatch.atlas.atlas import Atlas
from magmatch.atlas.find import find_map, find_walk
from magmatch.data.diagnoses import warn
from magmatch.data.survey import Survey
from magmatch.field.map import FieldMap
from magmatch.progress import Progress, followed
from magmatch.registration.advice import with_advice
from magmatch.registration.clock import Clock
from magmatch.registration.maps import require_target, survey_of
from magmatch.registration.prepared.walk import choose_search
from magmatch.registration.provenance import stamped
from magmatch.registration.result import RegistrationResult
from magmatch.threads import one_blas_thread


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
            used, answer = target, find_walk(atlas, target, survey, seed, clock)
        else:
            can_help = not any(one.is_of_frames for one in diagnoses)
            used, answer = find_map(atlas, target, survey, seed, clock, can_calibrate=can_help)
    found = [atlas.load(entry).field_map.survey for entry in atlas.entries if entry.name == answer.base]
    surveys = dict(zip(("base", "target") if found else ("target",), (*found, survey), strict=True))
    answer = with_advice(answer, surveys, config.prior)
    return used, stamped(answer, (*found, survey), config, seed, clock)
