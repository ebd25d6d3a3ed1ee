# SPDX-License-Identifier: BSD-3-Clause
"""Words on stderr: what the library logs, as progress while it works and as warnings once it is done."""

import logging
import re
import sys
import warnings
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING

from magmatch.errors import in_short
from magmatch.progress import followed

if TYPE_CHECKING:
    from rich.status import Status

# Loggers of the readers, and of the service (a distribution of its own), which runs until it is stopped.
READING, SERVING = "magmatch.data", "magmatch.serve"
FIGURES = re.compile(r"[-+.,\d]*\d")


class Narrator(logging.Handler):
    """Follows the library's log.

    If stderr is a terminal, information is shown as a temporary progress line; messages above that level (that loops
    are compiled) stay. Warnings are held back while files are read, because a command that fails should print its
    error only. They are printed before the work begins, and those of the work at its end; each is printed once for
    all files concerned.
    """

    def __init__(self) -> None:
        super().__init__(logging.INFO)
        self.is_verbose = False  # print every message as it comes
        self.is_debugging = False  # show tracebacks
        self._status: Status | None = None
        self._is_working = False
        # Files and words by kind of warning, held back; kinds and files held back or said.
        self._warnings: dict[str, tuple[list[str], str]] = {}
        self._known: set[tuple[str, str]] = set()

    def emit(self, record: logging.LogRecord) -> None:
        """Handle one message of the library."""
        message = record.getMessage()
        is_warning = record.levelno >= logging.WARNING
        if self.is_verbose or record.name.startswith(SERVING):
            self.rest()
            say(f"warning: {message}" if is_warning else message)
            return
        if is_warning:
            self._hold(record)
            return
        if not (self._is_working or record.name.startswith(READING)):
            self._is_working = True
            self.finish()
        if record.levelno > logging.INFO:
            self.rest()
            say(message)
        else:
            self.follow(message)

    def rest(self) -> None:
        """Remove the progress line."""
        if self._status is not None:
            self._status.stop()
            self._status = None

    def finish(self) -> None:
        """Print the warnings that were held back."""
        self.rest()
        for files, words in self._warnings.values():
            alike = f" (also {', '.join(in_short(files[1:]))})" if files[1:] else ""
            say(f"warning: {files[0] + ': ' if files[0] else ''}{words}{alike}")
        self._warnings.clear()

    def _hold(self, record: logging.LogRecord) -> None:
        """Keep a warning; warnings that differ only in file and figures count as one."""
        files, words = "", record.getMessage()
        if record.msg.startswith("%s: ") and isinstance(record.args, tuple):
            files = str(record.args[0])
            words = words.removeprefix(f"{files}: ")
        kind = FIGURES.sub("", words)
        for file in files.split(", "):
            if (kind, Path(file).name) not in self._known:
                self._known.add((kind, Path(file).name))
                self._warnings.setdefault(kind, ([], words))[0].append(file)

    def follow(self, message: str, share: float | None = None) -> None:
        """Show the current step, if stderr is a terminal."""
        if self.is_verbose or not sys.stderr.isatty():
            return
        if share:
            message += f" ({share:.0%})"
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
    """Follow the library's log during one command."""
    logger, narrator = logging.getLogger("magmatch"), Narrator()
    level = logger.level
    logger.addHandler(narrator)
    logger.setLevel(logging.INFO)
    try:
        with warnings.catch_warnings():
            # Warnings of NumPy and numba are for developers; ours come through the log.
            warnings.simplefilter("ignore")
            with followed(narrator.follow):
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
    print(text, flush=True)  # noqa: T201
