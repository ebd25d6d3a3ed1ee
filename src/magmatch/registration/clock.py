# SPDX-License-Identifier: BSD-3-Clause
"""Seconds per stage of one registration: ``with clock("search"): ...``."""

from collections.abc import Iterator
from contextlib import contextmanager
from time import perf_counter


class Clock:
    """Adds up the wall time of named stages."""

    def __init__(self) -> None:
        self._start = perf_counter()
        self._stages: dict[str, float] = {}

    @contextmanager
    def __call__(self, stage: str) -> Iterator[None]:
        """Add the time spent in the block to a stage."""
        start = perf_counter()
        try:
            yield
        finally:
            self._stages[stage] = self._stages.get(stage, 0.0) + perf_counter() - start

    def seconds(self) -> dict[str, float]:
        """Seconds per stage so far, and in total since the start."""
        return {**self._stages, "total": perf_counter() - self._start}
