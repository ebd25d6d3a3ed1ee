# SPDX-License-Identifier: BSD-3-Clause
"""Errors that a caller can act on: each message says where, what was expected and what was found."""

import copyreg
import json
from collections.abc import Sequence
from importlib import import_module
from pathlib import Path
from types import ModuleType
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from pydantic import ValidationError

# More names than this are counted in messages.
MOST_NAMES = 3
# What JSON calls that which pydantic names after Python's types.
_EXPECTED = dict.fromkeys(("dict_type", "dataclass_type"), "an object") | {
    "tuple_type": "a list",
    "list_type": "a list",
    "too_short": "{min_length} items",
    "too_long": "{max_length} items",
}


class MagmatchError(Exception):
    """Base of all errors that magmatch raises on purpose; the command line shows it as one line, exit code 2."""

    def __reduce__(self) -> tuple[Any, ...]:
        # As it is: what is given to __init__ is no longer known in another process.
        return copyreg.__newobj__, (type(self), *self.args), self.__dict__  # type: ignore[attr-defined]


class DataFormatError(MagmatchError, ValueError):
    """A file does not hold what it should."""

    def __init__(self, path: str | Path, message: str, *, line: int | None = None, column: str | None = None) -> None:
        self.path, self.message, self.line, self.column = Path(path), message, line, column
        place = str(path)
        if line is not None:
            place += f", line {line}"
        if column is not None:
            place += f", column '{column}'"
        super().__init__(f"{place}: {message}")


class SurveyError(MagmatchError, ValueError):
    """A survey cannot be used: NaN, impossible magnitudes, too few samples, times that decrease."""


class ConfigurationError(MagmatchError, ValueError):
    """A setting is out of its bounds or unknown."""


class DatasetError(MagmatchError, OSError):
    """A public recording is unavailable: no connection, or the download differs from the published file."""


class TaskError(MagmatchError, RuntimeError):
    """A task that was given to another process or machine failed."""


class MissingExtraError(MagmatchError, ImportError):
    """An optional dependency is not installed; names the extra that brings it."""

    def __init__(self, feature: str, extra: str, package: str = ".") -> None:
        # `package` is the folder of the distribution, from the root of a checkout, whose extra it is.
        install = f"pip install '{package}[{extra}]'"
        super().__init__(f"{feature} needs the extra '{extra}': {install} (in a checkout of magmatch)")


def import_extra(module: str, feature: str, extra: str, package: str = ".") -> ModuleType:
    """Import an optional module; where it is not installed, the error names its feature, and how to install it."""
    try:
        return import_module(module)
    except ImportError:
        raise MissingExtraError(feature, extra, package) from None


def first_fault(error: "ValidationError") -> tuple[str, str]:
    """Say where the first impossible value stands, and what was expected and found there."""
    first = error.errors(include_url=False)[0]
    place, kind = " ".join(".".join(map(str, first["loc"])).split())[:100], first["type"]
    if kind == "missing":
        return place, "missing"
    if kind == "value_error":
        return place, first["msg"].removeprefix("Value error, ")
    said = f"expected {_EXPECTED[kind].format(**first.get('ctx', {}))}" if kind in _EXPECTED else first["msg"]
    found = json.dumps(first["input"], default=str, skipkeys=True)[:60]
    return place, f"{said.replace('Input should be', 'expected')}, found {found}"


def in_short(names: Sequence[str]) -> list[str]:
    """Names of a few things; of many, the first two and how many more."""
    return [*names] if len(names) <= MOST_NAMES else [*names[:2], f"{len(names) - 2} others"]
