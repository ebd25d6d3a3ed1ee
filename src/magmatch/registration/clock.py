# SPDX-License-Identifier: BSD-3-Clause
"""Seconds per stage of one registration."""

from collections.abc import Callable
from time import perf_counter
from typing import ParamSpec, TypeVar

P = ParamSpec("P")
T = TypeVar("T")


class Stopwatch:
    """Adds up the wall time of named stages."""

    def __init__(self) -> None:
        self._start = perf_counter()
        self._stages: dict[str, float] = {}

    def time(self, stage: str, step: Callable[P, T], *args: P.args, **kwargs: P.kwargs) -> T:
        """Run a step and add its time to a stage."""
        start = perf_counter()
        try:
            return step(*args, **kwargs)
        finally:
            self._stages[stage] = self._stages.get(stage, 0.0) + perf_counter() - start

    def seconds(self) -> dict[str, float]:
        """Seconds per stage so far, and in total since the start."""
        return {**self._stages, "total": perf_counter() - self._start}
