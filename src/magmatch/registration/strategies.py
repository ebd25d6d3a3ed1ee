# SPDX-License-Identifier: BSD-3-Clause
"""The strategies for a target, in the order they are tried."""

from collections.abc import Iterator
from typing import Any

from magmatch.data.survey import Survey
from magmatch.estimation.walk import choose_search, is_line
from magmatch.field.map import FieldMap
from magmatch.registration.clock import Clock
from magmatch.registration.config import RegistrationConfig
from magmatch.registration.map_strategy import MapStrategy
from magmatch.registration.strategy import Strategy
from magmatch.registration.walk_strategy import WalkStrategy


def strategies(
    length: float, target: Survey | FieldMap, samples: Survey, config: RegistrationConfig, seed: int, clock: Clock
) -> Iterator[Strategy[Any, Any, Any]]:
    """Compare as a walk if samples are a line, short in the base's correlation lengths; otherwise, or next, as a map.

    A long line that turns and crosses itself may cover an area, so it is tried as a map first and as a walk next.
    The target is mapped only when that strategy is used.
    """
    search = choose_search(samples, length) if config.search == "auto" else config.search
    walk = WalkStrategy(target, samples, config, seed)
    if search == "pairs":
        yield walk
    if config.search != "pairs":
        yield MapStrategy.of(target, config, seed, clock)
    if config.search == "auto" and search != "pairs" and is_line(samples, length):
        yield walk
