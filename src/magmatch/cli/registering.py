# SPDX-License-Identifier: BSD-3-Clause
"""`register` needs more than the library's function: compilation in advance, and timing."""

from dataclasses import replace
from time import perf_counter
from typing import TYPE_CHECKING

from magmatch.cli import STARTED

if TYPE_CHECKING:
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
