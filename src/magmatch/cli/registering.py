# SPDX-License-Identifier: BSD-3-Clause
"""What `register` and `demo` call: the library's verbs, keeping the base's map for a picture."""

from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING

from magmatch.cli.command import Layouts
from magmatch.cli.inputs import read_survey_or_map

if TYPE_CHECKING:
    from magmatch.data.survey import Survey
    from magmatch.field.map import FieldMap
    from magmatch.registration.config import RegistrationConfig
    from magmatch.registration.map_index import MapIndex
    from magmatch.registration.result import RegistrationResult


def register_keeping_base(
    base: "Survey | FieldMap | MapIndex", target: "Survey | FieldMap", settings: "RegistrationConfig", seed: int
) -> "tuple[FieldMap, RegistrationResult]":
    """Register, and hand on the map of the base that was made on the way.

    Parameters
    ----------
    base : Survey, FieldMap or MapIndex
    target : Survey or FieldMap
    settings : RegistrationConfig
    seed : int

    Returns
    -------
    base_map : FieldMap
    result : RegistrationResult
        The same as `magmatch.register` gives; its seconds include the mapping.
    """
    from magmatch.data.survey import Survey
    from magmatch.registration.map_index import MapIndex
    from magmatch.registration.register import as_map, register
    from magmatch.registration.stopwatch import Stopwatch

    clock = Stopwatch()
    made = clock.time("base map", as_map, base, settings) if isinstance(base, Survey) else base
    result = register(made, target, settings, seed=seed)
    seconds = {stage: s for stage, s in result.seconds.items() if stage != "total"}
    base_map = made.field_map if isinstance(made, MapIndex) else made
    return base_map, replace(result, seconds=seconds | clock.seconds())


def register_in_folder(
    folder: Path, target: "Survey | FieldMap", settings: "RegistrationConfig", seed: int
) -> "tuple[FieldMap | None, RegistrationResult]":
    """Find a target in a folder of maps.

    Parameters
    ----------
    folder : Path
    target : Survey or FieldMap
    settings : RegistrationConfig
    seed : int

    Returns
    -------
    base_map : FieldMap or None
        The map that the result names.
    result : RegistrationResult
    """
    from magmatch.atlas.atlas import open_atlas
    from magmatch.atlas.localize import localize

    atlas = open_atlas(folder, settings)
    result = localize(atlas, target, seed=seed)
    named = [sheet for sheet in atlas.sheets if sheet.name == result.base]
    return atlas.load(named[0]).field_map if named else None, result


def read_base(path: Path, layouts: Layouts, settings: "RegistrationConfig") -> "Survey | FieldMap | MapIndex":
    """Read the base: a survey, or a saved map with its index where there is one beside it.

    Parameters
    ----------
    path : Path
    layouts : Layouts
        Options that say how to read it.
    settings : RegistrationConfig
        What the index must have been made with.

    Returns
    -------
    Survey, FieldMap or MapIndex
    """
    from magmatch.data.survey import Survey
    from magmatch.errors import DataFormatError
    from magmatch.registration.map_index import open_index

    base = read_survey_or_map(path, layouts, "base")
    index = None if isinstance(base, Survey) else open_index(path, settings)
    if index is None or isinstance(base, Survey):
        return base
    try:
        return index.load(base)
    except DataFormatError:  # an index is a cache: without it the answer only takes longer
        return base
