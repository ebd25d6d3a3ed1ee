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
    """What speaks for a refined pose."""

    @property
    def log_density(self) -> float:
        """Comparable between bases, nats."""


BaseSide = TypeVar("BaseSide")
TargetSide = TypeVar("TargetSide")
Weight = TypeVar("Weight", bound=Evidence)


@dataclass(frozen=True, eq=False, slots=True)
class Pair(Generic[BaseSide, TargetSide]):
    """Base and target as a strategy sees them, and what is known of the pose beforehand."""

    base: BaseSide
    target: TargetSide
    prior: PosePrior


@dataclass(frozen=True, eq=False, slots=True)
class Weighed(Generic[BaseSide, TargetSide, Weight]):
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

    pair: Pair[BaseSide, TargetSide]
    found: SearchResult
    ranked: list[Weight]
    lead: float = np.inf
    decoy_evidence: float | None = None

    @property
    def log_density(self) -> float:
        """Of the best pose, comparable between bases, nats; -inf where there is none."""
        return self.ranked[0].log_density if self.ranked else -np.inf


class Strategy(Protocol[BaseSide, TargetSide, Weight]):
    """The steps of a registration, in their order."""

    @property
    def target(self) -> Survey | FieldMap:
        """The target as it was used."""

    def pair(self, base: MapIndex, volume: float | None = None) -> Pair[BaseSide, TargetSide]:
        """Both sides as they are compared; ``volume`` (m^3) is that of all regions searched, this base's if None."""

    def search(self, pair: Pair[BaseSide, TargetSide]) -> SearchResult:
        """Poses worth a look."""

    def refine_and_weigh(
        self, pair: Pair[BaseSide, TargetSide], found: SearchResult
    ) -> Weighed[BaseSide, TargetSide, Weight]:
        """Refine the candidates against the field, and weigh each against the null model."""

    def search_decoys(self, weighed: Weighed[BaseSide, TargetSide, Weight]) -> Weighed[BaseSide, TargetSide, Weight]:
        """Add what the same search reaches in places that do not exist, where that may matter."""

    def decide(self, weighed: Weighed[BaseSide, TargetSide, Weight]) -> RegistrationResult:
        """Accept or refuse the best pose, and state the result."""

    def settle(
        self, weighed: Weighed[BaseSide, TargetSide, Weight], answer: RegistrationResult
    ) -> RegistrationResult:
        """Widen an accepted covariance by the maps' own errors, which residuals do not show."""
