# SPDX-License-Identifier: BSD-3-Clause
"""Words on stderr: what the library logs, as progress while it works and as warnings once it is done."""

import logging
import sys
import warnings
from collections.abc import Iterator
from contextlib import contextmanager
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from rich.status import Status


class Narrator(logging.Handler):
    """Follows the library's log.

    Information becomes a line that comes and goes while work is under way, where stderr is a terminal; what is above
    it (that loops are compiled) stays. Warnings are
    held back until the command has done its work: a command that fails says one thing only, what is wrong.

    Attributes
    ----------
    is_verbose : bool
        Print every message as it comes.
    is_debugging : bool
        Show tracebacks.
    """

    def __init__(self) -> None:
        super().__init__(logging.INFO)
        self.is_verbose = False
        self.is_debugging = False
        self._status: Status | None = None
        self._warnings: list[str] = []

    def emit(self, record: logging.LogRecord) -> None:
        """Take one message of the library."""
        message = record.getMessage()
        is_warning = record.levelno >= logging.WARNING
        if self.is_verbose:
            say(f"warning: {message}" if is_warning else message)
        elif is_warning:
            self._warnings.append(message)
        elif record.levelno > logging.INFO:
            self.rest()
            say(message)
        elif sys.stderr.isatty():
            self._follow(message)

    def rest(self) -> None:
        """Take the progress line away."""
        if self._status is not None:
            self._status.stop()
            self._status = None

    def finish(self) -> None:
        """Say the warnings that were held back, each once."""
        self.rest()
        for message in dict.fromkeys(self._warnings):
            say(f"warning: {message}")
        self._warnings.clear()

    def _follow(self, message: str) -> None:
        text = message.replace("[", "\\[")  # rich would take brackets for markup
        if self._status is None:
            from rich.console import Console
            from rich.status import Status

            self._status = Status(text, console=Console(stderr=True))
            self._status.start()
        else:
            self._status.update(text)


@contextmanager
def narrated() -> Iterator[Narrator]:
    """Follow the library's log for the time of one command."""
    logger, narrator = logging.getLogger("magmatch"), Narrator()
    level = logger.level
    logger.addHandler(narrator)
    logger.setLevel(logging.INFO)
    try:
        with warnings.catch_warnings():
            # Warnings of NumPy and numba are for developers; ours come through the log.
            warnings.simplefilter("ignore")
            yield narrator
    finally:
        narrator.rest()
        logger.removeHandler(narrator)
        logger.setLevel(level)


def say(text: str) -> None:
    """Put words for people on stderr."""
    print(text, file=sys.stderr)  # noqa: T201


def put(text: str) -> None:
    """Put data on stdout."""
    print(text)  # noqa: T201
