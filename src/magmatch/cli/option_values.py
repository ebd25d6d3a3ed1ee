# SPDX-License-Identifier: BSD-3-Clause
"""Options that several commands take: numbers, the vertical, processes; errors name them."""

from collections.abc import Iterator
from contextlib import contextmanager
from math import isfinite
from typing import TYPE_CHECKING, NoReturn

from magmatch.errors import ConfigurationError

if TYPE_CHECKING:
    from magmatch.workers import DaskRunner


def numbers(option: str, text: str, n: int, expected: str) -> list[float]:
    """Parse n finite numbers separated by commas."""
    try:
        found = [float(part) for part in text.split(",")]
    except ValueError:
        found = []
    if len(found) != n or not all(map(isfinite, found)):
        refuse(option, expected, text)
    return found


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


@contextmanager
def processes(jobs: int, scheduler: str | None, ahead: int = 1) -> "Iterator[DaskRunner | None]":
    """Give what runs tasks in other processes, or None where this one does all of the work."""
    if jobs == 1 and scheduler is None:
        yield None
        return
    from magmatch.workers import DaskRunner

    if scheduler is not None and "://" not in scheduler:
        refuse("--scheduler", "an address such as tcp://10.0.0.1:8786", scheduler)
    with DaskRunner(jobs, scheduler, ahead) as run:
        if scheduler is not None:
            _ = run.client  # before long work, whether it answers
        yield run
