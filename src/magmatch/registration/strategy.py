# SPDX-License-Identifier: BSD-3-Clause
"""How a target is compared with a base, as a map or as a walk: the steps that both fill, and their order."""

from dataclasses import dataclass
from typing import Generic, Protocol, TypeVar

import numpy as np

from magmatch.data.survey import Survey
from magmatch.field.map import FieldMap
from magmatch.registration.index.map_index import MapIndex
from magmatch.registration.prepared.pose_prior import PosePrior
from magmatch.registration.result import RegistrationResult
from magmatch.registration.search.candidate import SearchResult


class Evidence(Protocol):
    """What a refined pose has for it."""

    @property
    def log_density(self) -> float:
        """Comparable between bases, nats."""


Base = TypeVar("Base")
Target = TypeVar("Target")
Weight = TypeVar("Weight", bound=Evidence)


@dataclass(frozen=True, eq=False, slots=True)
class Pair(Generic[Base, Target]):
    """Base and target as a strategy sees them, and what is known of the pose beforehand."""

    base: Base
    target: Target
    prior: PosePrior


@dataclass(frozen=True, eq=False, slots=True)
class Weighed(Generic[Base, Target, Weight]):
    """Poses of a pair, refined and weighed; nothing is decided yet.

    Attributes
    ----------
    ranked : list
        Best first.
    lead : float, nats
        How far the best pose is ahead of the best one in any other base.
    decoy_evidence : float or None, nats
        What the same search reaches in places that do not exist; None where it need not be known.
    """

    pair: Pair[Base, Target]
    found: SearchResult
    ranked: list[Weight]
    lead: float = np.inf
    decoy_evidence: float | None = None

    @property
    def log_density(self) -> float:
        """Of the best pose, comparable between bases, nats; -inf where there is none."""
        return self.ranked[0].log_density if self.ranked else -np.inf


class Strategy(Protocol[Base, Target, Weight]):
    """The steps of a registration, in their order.

    ``volume`` (m^3) is that of all regions in which the target is looked for, by default this base's.
    """

    @property
    def target(self) -> Survey | FieldMap:
        """The target as it was used."""

    def pair(self, base: MapIndex, volume: float | None = None) -> Pair[Base, Target]:
        """Bring base and target into the form that is compared."""

    def search(self, pair: Pair[Base, Target]) -> SearchResult:
        """Poses worth a look."""

    def weigh(self, pair: Pair[Base, Target], found: SearchResult) -> Weighed[Base, Target, Weight]:
        """Refine the candidates against the field, and weigh each against the null model."""

    def search_decoys(self, weighed: Weighed[Base, Target, Weight]) -> Weighed[Base, Target, Weight]:
        """Add what the same search reaches in places that do not exist, where that may matter."""

    def decide(self, weighed: Weighed[Base, Target, Weight]) -> RegistrationResult:
        """Accept or refuse the best pose, and state the result."""

    def settle(self, weighed: Weighed[Base, Target, Weight], answer: RegistrationResult) -> RegistrationResult:
        """Add to an answer what the residuals of this comparison cannot show: how far the maps themselves err."""
