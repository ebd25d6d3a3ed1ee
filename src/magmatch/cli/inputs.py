# SPDX-License-Identifier: BSD-3-Clause
"""Files that commands take: a survey or a saved map, recognised by content."""

from collections.abc import Sequence
from contextlib import suppress
from glob import glob, has_magic
from itertools import chain
from pathlib import Path
from typing import TYPE_CHECKING

from magmatch.cli.command import Layouts, flag_of
from magmatch.cli.narration import say
from magmatch.cli.option_values import refuse
from magmatch.errors import ConfigurationError, DataFormatError

if TYPE_CHECKING:
    from magmatch.data.survey import Survey
    from magmatch.data.trajectory import Trajectory
    from magmatch.field.map import FieldMap
    from magmatch.registration.result import RegistrationResult


def read_survey_or_map(path: Path, layouts: Layouts, survey: str = "") -> "Survey | FieldMap":
    """Read a file according to its content."""
    from magmatch.data.read import read_survey

    return read_map(path) if is_map(path, layouts, survey) else read_survey(path, layouts.of(survey))


def is_map(path: Path, layouts: Layouts, survey: str = "") -> bool:
    """Whether a file is a saved map, for which no layout of its own may be stated, or a survey."""
    from magmatch.data.formats.sniff import sniff

    if sniff(path) != "map":
        return False
    stated = [name for of, name in layouts.given if of == survey]
    if stated and survey:
        msg = f"{path} is a saved map, whose units and frame are known; leave out {flag_of(survey, stated[0])}"
        raise ConfigurationError(msg)
    return True


def read_map(path: Path) -> "FieldMap":
    """Read a saved map."""
    from magmatch.field.map import FieldMap

    _require_kind(path, "map", "a saved map", "; make a map with 'magmatch map SURVEY --out MAP'")
    return FieldMap.load(path)


def read_samples(path: Path, layouts: Layouts, survey: str = "") -> "Survey":
    """Read the samples of a survey, or those a saved map was made from."""
    from magmatch.data.read import read_survey

    return read_map(path).survey if is_map(path, layouts, survey) else read_survey(path, layouts.of(survey))


def read_poses_of(path: Path, layouts: Layouts) -> "Trajectory | None":
    """Read a log's poses at their own times, if these differ from the samples' times."""
    from magmatch.data.formats.sniff import sniff
    from magmatch.data.read import read_poses

    return None if sniff(path) == "map" else read_poses(path, layouts.of())


def logs_in(paths: Sequence[Path]) -> list[Path]:
    """Logs as given; in place of a folder that is no log itself, the logs in it, by name; of a pattern, what matches.

    Where there are logs of recorders or phones, tables beside them are none.
    """
    from magmatch.data.formats.phones.containers import is_hidden
    from magmatch.data.formats.sniff import sniff
    from magmatch.data.tables.text import is_folder

    found: list[Path] = []
    for path in chain.from_iterable(map(matches, paths)):
        kinds = {}
        try:
            sniff(path)
        except DataFormatError:
            if not is_folder(path):
                raise
            inside = [entry for entry in sorted(path.iterdir()) if not (is_hidden(entry.name) or entry.is_fifo())]
            for entry in inside:
                with suppress(DataFormatError):
                    kinds[entry] = sniff(entry)
            logs = [entry for entry, kind in kinds.items() if kind in ("phone", "log")]
            logs = logs or [entry for entry, kind in kinds.items() if kind in ("csv", "parquet", "mat")]
            if not logs:
                raise
            rest = [entry.name for entry in inside if entry not in logs]
            names = ", ".join(rest[:5]) + (", ..." if len(rest) > 5 else "")
            say(f"{path}: {len(logs)} logs{f'; not read: {names}' if rest else ''}")
            found += logs
        else:
            found.append(path)
    return found


def matches(path: Path) -> list[Path]:
    """Files that a pattern matches, by name, where the shell has left it; a file with such a name is itself."""
    if path.exists() or not has_magic(str(path)):
        return [path]
    if not (found := sorted(map(Path, glob(str(path), recursive=True)))):  # noqa: PTH207
        raise DataFormatError(path, "matches no file")
    return found


def require_own_poses(paths: Sequence[Path], layouts: Layouts, what: str) -> None:
    """Refuse one file of poses for several inputs that are no saved maps: it holds those of one."""
    from magmatch.data.formats.sniff import sniff

    if layouts.of().trajectory is not None and sum(sniff(path) != "map" for path in paths) > 1:
        each = f"magmatch convert {what} {what}_POSED.csv --trajectory POSES"
        refuse("--trajectory", f"a single {what}, whose poses it holds (else first: {each})", f"{len(paths)}")


def read_result(path: Path) -> "RegistrationResult":
    """Read a registration result."""
    from magmatch.registration.result import RegistrationResult

    _require_kind(path, "registration", "a registration result (JSON of 'magmatch register')")
    return RegistrationResult.load(path)


def _require_kind(path: Path, kind: str, expected: str, advice: str = "") -> None:
    from magmatch.data.formats.sniff import sniff

    if (found := sniff(path)) != kind:
        raise DataFormatError(path, f"expected {expected}, found a {found} file{advice}")
