# SPDX-License-Identifier: BSD-3-Clause
"""What `register` calls beside the library's verb: a folder of maps as the base, and a saved map with its index."""

from dataclasses import replace
from pathlib import Path
from time import perf_counter
from typing import TYPE_CHECKING

from magmatch.cli import STARTED
from magmatch.cli.command import Layouts
from magmatch.cli.inputs import read_survey_or_map

if TYPE_CHECKING:
    from magmatch.data.survey import Survey
    from magmatch.field.map import FieldMap
    from magmatch.registration.config import RegistrationConfig
    from magmatch.registration.index.map_index import MapIndex
    from magmatch.registration.result import RegistrationResult


def with_help() -> None:
    """Where loops must be compiled first: those of the search by another process, while this one makes the maps."""
    from magmatch.compiled import FIRST_USE

    FIRST_USE.next_module = "magmatch.registration.search.invariant_search"


def with_wait(result: "RegistrationResult", loaded: float) -> "RegistrationResult":
    """State what a user waited for besides: the program's start until it was loaded, and the reading of files."""
    now, seconds = perf_counter(), dict(result.seconds)
    reading = now - loaded - seconds.pop("total")
    return replace(result, seconds={"start": loaded - STARTED, "read": reading, **seconds, "total": now - STARTED})


def read_base(path: Path, layouts: Layouts, settings: "RegistrationConfig") -> "Survey | FieldMap | MapIndex":
    """Read the base: a survey, or a saved map with its index where there is one beside it."""
    from magmatch.data.survey import Survey
    from magmatch.errors import DataFormatError
    from magmatch.registration.index.map_index import open_index

    base = read_survey_or_map(path, layouts, "base")
    index = None if isinstance(base, Survey) else open_index(path, settings)
    if index is None or isinstance(base, Survey):
        return base
    try:
        return index.load(base)
    except DataFormatError:  # an index is a cache: without it the answer only takes longer
        return base
