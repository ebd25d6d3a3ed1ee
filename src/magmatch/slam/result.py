# SPDX-License-Identifier: BSD-3-Clause
"""The result of slam and merge, with uncertainties and rejected closures: one typed document."""

from dataclasses import dataclass, field
from enum import StrEnum
from typing import Annotated, Any

from pydantic import Field
from typing_extensions import TypedDict

from magmatch.brief import brief
from magmatch.data.document import TypedDocument
from magmatch.registration.result import Count, Covariance, Fraction, Length, Number, NumberOrNull, Three, Transform


class SlamStatus(StrEnum):
    """Whether the logs share a frame now."""

    CONNECTED = "connected"  # every log is in one frame; a single log was corrected
    PARTLY_CONNECTED = "partly_connected"  # closures were found, but not all logs hang together
    UNCHANGED = "unchanged"  # nothing was passed twice


@dataclass(frozen=True, eq=False, slots=True)
class LogResult:
    """The result for one log.

    Attributes
    ----------
    name : str
        Stem of its file, made unique; its outputs are named so.
    component : int
        Which frame it is in; 0 holds the longest path.
    T_map_log : RigidTransform or None
        Corrected first pose times the inverse of the odometry's first; None if it is connected to no other log.
    length : float, m
        Path length.
    n_closures : int
        Closures that the graph keeps, with itself or others.
    moved : float, m
        Root mean square correction of the samples relative to the odometry, with the first pose held.
    sd : (2,) floats, m and rad
        Standard deviation of its end, position and rotation, relative to the beginning of its component's first log,
        or in the frame of the fixed points. For rigid surveys: of the whole survey.
    is_fixed : bool
        Whether its frame is that of the fixed points.
    """

    name: str
    component: Count
    T_map_log: Transform | None
    length: Length
    n_closures: Count
    moved: Length
    sd: Annotated[tuple[Length, Length], Field()]
    is_fixed: bool = False


@dataclass(frozen=True, eq=False, slots=True)
class ClosureResult:
    """A loop closure: two places of logs that coincide according to the field.

    Attributes
    ----------
    log_a, log_b : str
        Names of the logs.
    t_a, t_b : float or None, s
        On the logs' own clocks; None where a log has no times, or is rigid.
    walked_a, walked_b : float, m
        Path up to there.
    T_a_b : RigidTransform
        Pose of b's body at ``t_b`` in the axes of a's body at ``t_a``; of logs without orientations in the
        odometry's axes there. Of rigid surveys: takes b's coordinates to a's.
    covariance : (6, 6) array
        Of xi in ``T_true = T_a_b Exp(xi)``, rotation first (rad, m).
    probability : float
        That it is right, from the field alone.
    weight : float
        Probability that it is right, given the graph; 0 if the graph rejected it.
    """

    log_a: str
    t_a: Number | None
    log_b: str
    t_b: Number | None
    T_a_b: Transform
    covariance: Covariance
    probability: Fraction
    weight: Fraction
    walked_a: Length = 0.0
    walked_b: Length = 0.0

    __repr__ = brief


@dataclass(frozen=True, eq=False, slots=True)
class AnchorResult:
    """A fixed point, and the residual of the log there.

    Attributes
    ----------
    log, t
        Which log was there, and when (s).
    position : (3,) floats, m
        Where it is.
    sd : float, m
        As stated, per coordinate.
    off : (3,) floats, m
        Vector from there to the log's corrected position.
    off_without, sd_without : (3,) floats and float, m
        From there to where odometry, closures and the other points have the log, and how well that is known, per
        coordinate: far beyond it, the point is wrong.
    """

    log: str
    t: Number
    position: Three[Number]
    sd: Length
    off: Three[Number]
    off_without: Three[Number]
    sd_without: Length


class Recalibration(TypedDict):
    """A jump of the magnetometer's own calibration, which was taken out of the readings."""

    t: Number  # s, of the first reading after it
    step: Three[Number]  # T, in the magnetometer's axes


class LogOdometry(TypedDict):
    """Estimated constant errors of one log."""

    scale: Number  # a share, of the length of each step
    turn_rate: Number  # rad/m
    bias: Three[Number]  # T, of the magnetometer in its own axes
    bias_sd: Three[NumberOrNull]
    recalibrations: list[Recalibration]  # of the magnetometer by itself, on the way


class DriftResult(TypedDict, total=False):
    """The drift of the odometry, and its constant errors by log."""

    sd: tuple[Number, Number]  # m and degrees, of a walk of 10 m: as stated, or as the closures show it
    logs: dict[str, LogOdometry]


@dataclass(frozen=True, eq=False, slots=True)
class SlamResult(TypedDocument):
    """The answer of `slam` or `merge`; fields are in the order of the file.

    Attributes
    ----------
    status, reason
        Whether all logs share a frame, and in words why, or what to do.
    logs : tuple of LogResult
        In the order given.
    closures : tuple of ClosureResult
        Including those that the graph rejected.
    anchors : tuple of AnchorResult
        Fixed points that were given.
    odometry : dict
        Noise and biases; empty for rigid surveys.
    seconds : dict
        Per stage and total.
    config, version, seed, inputs
        Enough to repeat the run and get the same numbers.
    """

    SCHEMA = "magmatch.slam/1"
    KIND = "result of slam or merge"

    status: SlamStatus
    reason: str
    logs: tuple[LogResult, ...]
    closures: tuple[ClosureResult, ...] = ()
    anchors: tuple[AnchorResult, ...] = ()
    odometry: DriftResult = field(default_factory=DriftResult)
    seconds: dict[str, NumberOrNull] = field(default_factory=dict)
    config: dict[str, Any] = field(default_factory=dict)
    version: str = ""
    seed: Count = 0
    inputs: tuple[dict[str, Any], ...] = ()

    __repr__ = brief

    @property
    def is_connected(self) -> bool:
        """Whether every log is in one frame, or the only one corrected."""
        return self.status is SlamStatus.CONNECTED

    def tested_anchors(self) -> tuple[AnchorResult, ...]:
        """Fixed points that show an error: all else tells where the log passes them, if only within its length."""
        length = {log.name: log.length for log in self.logs}
        return tuple(point for point in self.anchors if point.sd_without < length[point.log])
