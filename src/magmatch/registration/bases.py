# SPDX-License-Identifier: BSD-3-Clause
"""A target may lie in one map, or in one of many (`Atlas`)."""

from dataclasses import dataclass
from typing import Any, Protocol

from magmatch.data.survey import Survey
from magmatch.registration.config import RegistrationConfig
from magmatch.registration.index.map_index import MapIndex
from magmatch.registration.prepared.prepared_map import PreparedMap


class Bases(Protocol):
    """Maps that are searched together; ``one`` below is what `likely_for_walk` and `likely_for_map` list."""

    @property
    def config(self) -> RegistrationConfig:
        """Settings that the maps were prepared with."""

    @property
    def length(self) -> float:
        """The maps' correlation length (the median), m."""

    @property
    def volume(self) -> float:
        """Volume of the regions that the maps know, of all together, m^3."""

    def likely_for_walk(self, target: Survey, seed: int) -> list[Any]:
        """Maps that are searched in full for a walk, most likely first."""

    def likely_for_map(self, target: PreparedMap, seed: int) -> list[Any]:
        """Maps that are searched in full for a target that was mapped, most likely first."""

    def length_of(self, likely: list[Any]) -> float:
        """Correlation length by which a walk is binned for some of the maps, m."""

    def load(self, one: Any, /) -> MapIndex:
        """A map with what was prepared of it."""

    def name_of(self, one: Any, /) -> str | None:
        """Give the name of a map in a result; None where there is but one, which needs no name."""


@dataclass(frozen=True, eq=False, slots=True)
class OneBase:
    """A single map, which needs no votes."""

    index: MapIndex
    config: RegistrationConfig

    @property
    def length(self) -> float:
        """Its correlation length, m."""
        return self.index.length

    @property
    def volume(self) -> float:
        """Volume of the region that it knows, m^3."""
        return self.index.volume

    def likely_for_walk(self, target: Survey, seed: int) -> list[MapIndex]:  # noqa: ARG002
        """The map itself."""
        return [self.index]

    def likely_for_map(self, target: PreparedMap, seed: int) -> list[MapIndex]:  # noqa: ARG002
        """The map itself."""
        return [self.index]

    def length_of(self, likely: list[MapIndex]) -> float:
        """Its correlation length, m."""
        return likely[0].length

    def load(self, one: MapIndex) -> MapIndex:
        """The map itself."""
        return one

    def name_of(self, one: MapIndex) -> None:
        """None."""
