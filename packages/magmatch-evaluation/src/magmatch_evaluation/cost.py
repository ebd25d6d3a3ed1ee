# SPDX-License-Identifier: BSD-3-Clause
"""What a piece of work costs, and maps that several methods of a trial share at the full price."""

import sys
import time
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import ParamSpec, TypeVar

from magmatch.data.survey import Survey
from magmatch.field.build import build_map
from magmatch.field.config import FieldConfig
from magmatch.field.map import FieldMap

P = ParamSpec("P")
T = TypeVar("T")

STATUS, CLEAR_REFS = Path("/proc/self/status"), Path("/proc/self/clear_refs")


@dataclass(frozen=True, slots=True)
class Cost:
    """Seconds of the processor, and the largest memory of the process meanwhile.

    Where the system cannot set its mark back (other than Linux), the largest memory since the process began.
    """

    seconds: float
    peak_bytes: int


def measured(work: Callable[P, T], *args: P.args, **kwargs: P.kwargs) -> tuple[T, Cost]:
    """Do some work; return what it returned and what it cost."""
    if CLEAR_REFS.exists():
        CLEAR_REFS.write_text("5")  # sets the mark of the largest memory back to what is used now
    start = time.process_time()
    value = work(*args, **kwargs)
    return value, Cost(time.process_time() - start, _peak_bytes())


class MapShelf:
    """Maps of one pair: built once, charged in full to every method that asks for them."""

    def __init__(self) -> None:
        # The surveys are kept with their maps: while they live, no other has their address.
        self._maps: dict[tuple[int, str], tuple[Survey, FieldMap, Cost]] = {}
        self._built: list[Cost] = []
        self._shared: list[Cost] = []

    def build(self, survey: Survey, config: FieldConfig) -> FieldMap:
        """Give the map of a survey."""
        key = (id(survey), config.model_dump_json())
        is_new = key not in self._maps
        if is_new:
            self._maps[key] = (survey, *measured(build_map, survey, config))
        _, field_map, cost = self._maps[key]
        (self._built if is_new else self._shared).append(cost)
        return field_map

    def charge(self, own: Cost) -> Cost:
        """Return the cost of a method as if it had built all its maps itself, and forget what it asked for."""
        seconds = own.seconds + sum(cost.seconds for cost in self._shared)
        peak = max(cost.peak_bytes for cost in [own, *self._built, *self._shared])
        self._built, self._shared = [], []
        return Cost(seconds, peak)


def _peak_bytes() -> int:
    """Largest memory of this process, bytes; 0 where the system does not tell."""
    if STATUS.exists():
        for line in STATUS.read_text().splitlines():
            if line.startswith("VmHWM:"):
                return 1024 * int(line.split()[1])
    try:
        import resource
    except ImportError:  # Windows
        return 0
    largest = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    return largest if sys.platform == "darwin" else 1024 * largest
