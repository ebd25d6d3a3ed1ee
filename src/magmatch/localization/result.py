# SPDX-License-Identifier: BSD-3-Clause
"""The result of localising a log in a map: one typed document."""

from dataclasses import dataclass, field
from enum import StrEnum
from typing import Annotated, Any

import numpy as np
from pydantic import Field
from typing_extensions import TypedDict

from magmatch.brief import brief
from magmatch.data.document import TypedDocument
from magmatch.localization.estimate import LocalizerStatus, phase
from magmatch.registration.decide.decision import in_words
from magmatch.registration.result import Count, Fraction, Length, Number, NumberOrNull, Three

# Probability of a map that is told in words: less than a place is stated with.
LEAST_TOLD = 0.001


class LocalizationStatus(StrEnum):
    """The state of knowledge at the end of the log."""

    LOCALIZED = "localized"  # its last pose is stated
    LOST = "lost"  # some poses are stated, the last is not
    NEVER = "never"  # none is


@dataclass(frozen=True, eq=False, slots=True)
class Segment:
    """A part of the log with one status.

    Attributes
    ----------
    t0, t1 : float, s
        Its first and last pose, on the log's clock.
    status : LocalizerStatus
    why : str
    map : str or None
        Which map, where the pose is stated.
    is_place_known : bool
        Whether the place is; the pose may be too uncertain to be stated all the same.
    """

    t0: Number
    t1: Number
    status: LocalizerStatus
    why: str
    map: str | None = None
    is_place_known: bool = False

    @property
    def phase(self) -> str:
        """The status in words, in which a known place and an uncertain pose are told apart."""
        return phase(self.status, is_place_known=self.is_place_known)


class SensorResult(TypedDict):
    """The magnetometer at the last stated pose."""

    bias: Three[Number]  # T, body's axes
    bias_sd: Three[NumberOrNull]
    scale: Number  # its reading of a field over that of the map's sensor


class OdometryResult(TypedDict):
    """The odometry at the last stated pose."""

    scale: Number  # true length of a step over the odometry's
    sd: Annotated[
        list[Number], Field(min_length=2, max_length=2)
    ]  # after a walk of 10 m, as the walk shows it: position (m) and heading (deg)


@dataclass(frozen=True, eq=False, slots=True)
class LocalizationResult(TypedDocument):
    """The answer of `localize`; fields are in the order of the file.

    Attributes
    ----------
    status, reason
        The state at the end, and in words why.
    map : str or None
        The map of the last stated pose.
    maps : dict
        Of a folder: the likely maps, and the probability that the body was in each at that pose, or at the end of
        the log where no pose is stated. What is left to 1 is that it was in none of the folder's.
    first_fix : (s, m) or None
        When the first pose was stated, on the log's clock, and how far the body had walked.
    share : float
        Share of the log's time for which a pose is stated.
    sd : tuple of (s, m, rad)
        Of stated poses over time, evenly thinned: standard deviations of place and turn, worst directions.
    segments : tuple of Segment
    sensor, odometry : dict or None
        As estimated; None where no pose is stated.
    is_planar : bool
        Whether the log was taken to keep one height.
    seconds, config, version, seed, inputs
        Enough to repeat the run and get the same numbers.
    """

    SCHEMA = "magmatch.localization/1"
    KIND = "result of localize"

    status: LocalizationStatus
    reason: str
    map: str | None = None
    maps: dict[str, Fraction] = field(default_factory=dict)
    first_fix: tuple[Number, Length] | None = None
    share: Fraction = 0.0
    sd: tuple[tuple[Number, Length, Length], ...] = ()
    segments: tuple[Segment, ...] = ()
    sensor: SensorResult | None = None
    odometry: OdometryResult | None = None
    is_planar: bool = False
    seconds: dict[str, NumberOrNull] = field(default_factory=dict)
    config: dict[str, Any] = field(default_factory=dict)
    version: str = ""
    seed: Count = 0
    inputs: tuple[dict[str, Any], ...] = ()

    __repr__ = brief

    @property
    def is_place_known(self) -> bool:
        """Whether the log ended at a known place with a pose too uncertain to be stated: that is not to be lost."""
        return self.status is not LocalizationStatus.LOCALIZED and any(s.is_place_known for s in self.segments[-1:])

    @property
    def share_in_words(self) -> str:
        """Say for how much of the time a pose is stated, and how accurate those poses are."""
        if not self.sd:
            return f"a pose for {self.share:.0%} of the time"
        _, shift, turn = np.array(self.sd).T
        return (
            f"a pose for {self.share:.0%} of the time, sd {np.median(shift):.2g} m and "
            f"{np.degrees(np.median(turn)):.2g} degrees (at most {shift.max():.2g} m, {np.degrees(turn.max()):.2g})"
        )

    @property
    def maps_in_words(self) -> str:
        """Name a folder's likely maps, and say that it is none, with the probabilities; of one map, nothing."""
        if not self.maps:
            return ""
        none = max(1 - sum(self.maps.values()), 0.0)
        found = [(name, p) for name, p in self.maps.items() if p >= LEAST_TOLD]
        return ", ".join(f"{name} {in_words(p)}" for name, p in (*found, ("none of the maps", none)))

    @property
    def is_localized(self) -> bool:
        """Whether any pose is stated."""
        return self.status is not LocalizationStatus.NEVER
