# SPDX-License-Identifier: BSD-3-Clause
"""Options that take several numbers or one of a few values; errors name the option."""

from collections.abc import Iterable
from math import isfinite
from typing import NoReturn

from magmatch.errors import ConfigurationError


def numbers(option: str, text: str, n: int, expected: str) -> list[float]:
    """Parse n finite numbers separated by commas."""
    try:
        found = [float(part) for part in text.split(",")]
    except ValueError:
        found = []
    if len(found) != n or not all(map(isfinite, found)):
        refuse(option, expected, text)
    return found


def one_of(option: str, value: str, known: Iterable[str]) -> str:
    """Check that a value is one of those known."""
    if value not in known:
        refuse(option, f"one of {', '.join(known)}", value)
    return value


def vertical(*, planar: bool, no_gravity: bool) -> dict[str, object]:
    """Settings that ``--planar`` and ``--no-gravity`` change."""
    if planar and no_gravity:
        refuse("--planar", "z up, which --planar implies", "--no-gravity")
    from magmatch.settings import of_vertical

    return of_vertical(planar=planar, no_gravity=no_gravity)


def refuse(option: str, expected: str, found: str) -> NoReturn:
    """Raise the error for an invalid value of an option."""
    msg = f"{option}: expected {expected}; found '{found}'"
    raise ConfigurationError(msg) from None
