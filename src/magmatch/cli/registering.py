# SPDX-License-Identifier: BSD-3-Clause
"""What `register` needs besides the library's function: compilation in advance, timing, and a base with its index."""

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
    """If loops must be compiled first, let another process compile those of the search while this one makes maps."""
    from magmatch.compiled import FIRST_USE

    FIRST_USE.next_module = "magmatch.registration.search.invariant_search"


def with_wait(result: "RegistrationResult", loaded: float) -> "RegistrationResult":
    """Add the user's further waiting time to the result: loading the program and reading files."""
    now, seconds = perf_counter(), dict(result.seconds)
    reading = now - loaded - seconds.pop("total")
    return replace(result, seconds={"start": loaded - STARTED, "read": reading, **seconds, "total": now - STARTED})


@dataclass(frozen=True, eq=False, slots=True)
class ReadBase:
    """A base as it was read, with its index if there is one."""

    path: Path
    base: "Survey | FieldMap | MapIndex"
    key: str = ""  # from `index_key`, before a saved map was read; empty if there is nothing to store

    def keep(self, used: "FieldMap | MapIndex | None", settings: "RegistrationConfig") -> None:
        """Store what was computed from a saved map next to it, and say once how to compute the rest in advance."""
        from magmatch.registration.index.map_index import MapIndex, index_path, keep_index

        had = self.base if isinstance(self.base, MapIndex) else None
        if not self.key or not isinstance(used, MapIndex) or (had and not used.is_whole):
            return
        if used.field_map is not (had.field_map if had else self.base):  # it was calibrated: another map
            return
        is_kept = keep_index(self.path, settings, used, self.key)
        if not had and not (is_kept and used.is_whole):
            kept = f"Stored an index of the map in {index_path(self.path)}; " if is_kept else ""
            say(f"{kept}'magmatch index {self.path}' makes later registrations faster")


def read_base(path: Path, layouts: Layouts, settings: "RegistrationConfig", *, keep: bool) -> ReadBase:
    """Read the base: a survey, or a saved map with its index if there is one."""
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
    except DataFormatError:  # an index is a cache: without it, registration only takes longer
        return ReadBase(path, base, key)
