# SPDX-License-Identifier: BSD-3-Clause
"""What following a log through a map came to: one typed document."""

from dataclasses import dataclass, field, fields
from enum import StrEnum
from functools import cache
from pathlib import Path
from typing import Annotated, Any

from pydantic import Field, TypeAdapter
from typing_extensions import TypedDict

from magmatch.data.document import plain, read_typed, write_document
from magmatch.localization.estimate import LocalizerStatus
from magmatch.registration.result import Count, Fraction, Number, NumberOrNull, Three

SCHEMA = "magmatch.localization/1"
MAX_BYTES = 256 * 1024**2
Length = Annotated[Number, Field(ge=0)]


class LocalizationStatus(StrEnum):
    """What is known at the end of the log."""

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
    """

    t0: Number
    t1: Number
    status: LocalizerStatus
    why: str
    map: str | None = None


class SensorResult(TypedDict):
    """The magnetometer at the last stated pose; its scale is taken as it is."""

    bias: Three[Number]  # T, body's axes
    bias_sd: Three[NumberOrNull]
    scale: Number


class OdometryResult(TypedDict):
    """The odometry at the last stated pose."""

    scale: Number  # true length of a step over the odometry's


@dataclass(frozen=True, eq=False, slots=True)
class LocalizationResult:
    """The answer of `localize`; fields stand in the order of the file.

    Attributes
    ----------
    status, reason
        What is known at the end, and in words why no more.
    map : str or None
        The map of the last stated pose.
    first_fix : (s, m) or None
        When the first pose was stated, on the log's clock, and how far the body had walked.
    share : float
        Share of the log's time for which a pose is stated.
    segments : tuple of Segment
    sensor, odometry : dict or None
        As estimated; None where no pose is stated.
    is_planar : bool
        Whether the log was taken to keep one height.
    seconds, config, version, seed, inputs
        Enough to run it again and get the same numbers.
    """

    status: LocalizationStatus
    reason: str
    map: str | None = None
    first_fix: tuple[Number, Length] | None = None
    share: Fraction = 0.0
    segments: tuple[Segment, ...] = ()
    sensor: SensorResult | None = None
    odometry: OdometryResult | None = None
    is_planar: bool = False
    seconds: dict[str, NumberOrNull] = field(default_factory=dict)
    config: dict[str, Any] = field(default_factory=dict)
    version: str = ""
    seed: Count = 0
    inputs: tuple[dict[str, Any], ...] = ()

    @property
    def is_localized(self) -> bool:
        """Whether any pose is stated."""
        return self.status is not LocalizationStatus.NEVER

    def to_dict(self) -> dict[str, Any]:
        """What the result says, in lists, numbers and words, keys and order as in the file."""
        return {"schema": SCHEMA} | {f.name: plain(getattr(self, f.name), f.name) for f in fields(self)}

    def save(self, path: str | Path) -> None:
        """Write the result as JSON, whole or not at all."""
        write_document(path, self.to_dict())

    @classmethod
    def load(cls, path: str | Path) -> "LocalizationResult":
        """Read a result; saving it again gives the same bytes.

        Raises
        ------
        DataFormatError
            Not such a file, or one of its values cannot be; names the key.
        """
        return read_typed(path, _adapter, SCHEMA, "result of localize", MAX_BYTES)


@cache
def _adapter() -> TypeAdapter[LocalizationResult]:
    """Built when the first file is read."""
    return TypeAdapter(LocalizationResult)
