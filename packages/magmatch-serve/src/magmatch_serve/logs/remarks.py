# SPDX-License-Identifier: BSD-3-Clause
"""The library's remarks about a log go to whoever sent it instead of whoever runs the service."""

import logging
import re
from collections.abc import Collection, Iterator
from contextlib import contextmanager

# An option of the command line as advice names it, of the log alone, and its value.
OPTION = re.compile(r"--(?:target-)?([a-z]+(?:-[a-z]+)*)(?: (\w+))?")
IN_PYTHON = re.compile(r" \(in Python \w+\)")
NUMBERS = re.compile(r"[\d.]+")


class _Listener(logging.Handler):
    def __init__(self) -> None:
        super().__init__(logging.WARNING)
        self.heard: dict[str, str] = {}

    def emit(self, record: logging.LogRecord) -> None:
        """Keep the first of each kind: some are told of every sample."""
        words = record.getMessage()
        self.heard.setdefault(NUMBERS.sub("", words), words)


@contextmanager
def listening() -> Iterator[Collection[str]]:
    """Warnings of the library within the block, the first of each kind, instead of where else they would go."""
    logger, listener = logging.getLogger("magmatch"), _Listener()
    was_passed_on, logger.propagate = logger.propagate, False
    logger.addHandler(listener)
    try:
        yield listener.heard.values()
    finally:
        logger.removeHandler(listener)
        logger.propagate = was_passed_on


def in_query_words(words: str, switches: Collection[str], others: Collection[str]) -> str:
    """Advice in words of the query instead of options: ``field_unit=uT`` for ``--field-unit uT``."""

    def renamed(option: re.Match[str]) -> str:
        name, value = option[1].replace("-", "_"), option[2]
        if name in switches:
            return f"{name}=true" + (f" {value}" if value else "")
        if name in others:
            return name + (f"={value}" if value else "")
        return option[0]

    return IN_PYTHON.sub("", OPTION.sub(renamed, words))
