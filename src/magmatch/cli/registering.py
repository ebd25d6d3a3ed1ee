# SPDX-License-Identifier: BSD-3-Clause
"""What `register` calls beside the library's verb: a folder of maps as the base, and a saved map with its index."""

from dataclasses import dataclass, replace
from pathlib import Path
from time import perf_counter
from typing import TYPE_CHECKING

from magmatch.cli import STARTED
from magmatch.cli.command import Layouts
from magmatch.cli.inputs import read_survey_or_map
from magmatch.cli.narration import say

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


@dataclass(frozen=True, eq=False, slots=True)
class ReadBase:
    """A base as it was read, with its index where there is one beside it.

    Attributes
    ----------
    key : str
        Of `index_key`, before a saved map was read; empty where there is nothing to keep.
    """

    path: Path
    base: "Survey | FieldMap | MapIndex"
    key: str = ""

    def keep(self, used: "FieldMap | MapIndex | None", settings: "RegistrationConfig") -> None:
        """Keep beside a saved map what was prepared of it, and say once what spares the rest."""
        from magmatch.registration.index.map_index import MapIndex, index_path, keep_index

        had = self.base if isinstance(self.base, MapIndex) else None
        if not self.key or not isinstance(used, MapIndex) or (had and not used.is_whole):
            return
        if used.field_map is not (had.field_map if had else self.base):  # it was calibrated: another map
            return
        is_kept = keep_index(self.path, settings, used, self.key)
        if not had and not (is_kept and used.is_whole):
            kept = f"Kept what was prepared of the map in {index_path(self.path)}; " if is_kept else ""
            say(f"{kept}'magmatch index {self.path}' spares later targets the rest")


def read_base(path: Path, layouts: Layouts, settings: "RegistrationConfig", *, keep: bool) -> ReadBase:
    """Read the base: a survey, or a saved map with its index where there is one beside it."""
    from magmatch.data.formats.sniff import sniff
    from magmatch.data.survey import Survey
    from magmatch.errors import DataFormatError
    from magmatch.registration.index.map_index import index_key, open_index

    key = index_key(path, settings) if keep and sniff(path) == "map" else ""
    base = read_survey_or_map(path, layouts, "base")
    index = None if isinstance(base, Survey) else open_index(path, settings)
    if index is None or isinstance(base, Survey):
        return ReadBase(path, base, key)
    try:
        return ReadBase(path, index.load(base), "" if index.is_whole else key)
    except DataFormatError:  # an index is a cache: without it the answer only takes longer
        return ReadBase(path, base, key)
