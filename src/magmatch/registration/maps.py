# SPDX-License-Identifier: BSD-3-Clause
"""Surveys, maps and indexes are accepted alike: the samples of each, and the map of each."""

from typing import Any

from magmatch.arguments import expect_kind
from magmatch.data.checks import ADVICE, require_survey
from magmatch.data.survey import Survey
from magmatch.field.build import build_map
from magmatch.field.config import FieldConfig
from magmatch.field.map import FieldMap
from magmatch.registration.index.atlas import Atlas
from magmatch.registration.index.map_index import MapIndex
from magmatch.threads import side_by_side


def require_base(base: Any) -> None:
    """Raise an error unless this can be the base of a registration."""
    expect_kind(base, "base", (Survey, FieldMap, MapIndex, Atlas), ADVICE)
    if isinstance(base, Survey):
        require_survey(base)


def require_target(target: Any, name: str = "target") -> None:
    """Raise an error unless this can be the target of a registration."""
    expect_kind(target, name, (Survey, FieldMap), ADVICE | {"MapIndex": "its map is in .field_map"})
    if isinstance(target, Survey):
        require_survey(target)


def survey_of(survey_or_map: Survey | FieldMap | MapIndex) -> Survey:
    """Samples of a survey, or those that a map was made from."""
    if isinstance(survey_or_map, MapIndex):
        return survey_or_map.field_map.survey
    return survey_or_map.survey if isinstance(survey_or_map, FieldMap) else survey_or_map


def map_of(base: FieldMap | MapIndex) -> FieldMap:
    """The map of a base that was used."""
    return base.field_map if isinstance(base, MapIndex) else base


def as_map(survey_or_map: Survey | FieldMap, config: FieldConfig) -> FieldMap:
    """Map a survey; return a map unchanged."""
    return survey_or_map if isinstance(survey_or_map, FieldMap) else build_map(survey_or_map, config)


def map_base(
    base: Survey | FieldMap | MapIndex | Atlas, target: Survey | FieldMap, config: FieldConfig
) -> tuple[FieldMap | MapIndex | Atlas, Survey | FieldMap]:
    """Map a base that is a survey, and the target in parallel: one alone would leave a core idle."""
    if not isinstance(base, Survey):
        return base, target
    base_map, target_map = side_by_side(lambda side: as_map(side, config), (base, target))
    return base_map, target_map
