# SPDX-License-Identifier: BSD-3-Clause
"""`dead_reckon`: accelerometer and gyroscope of a walk in, its path out, level and from the origin."""

import logging
from dataclasses import dataclass

import numpy as np
from pydantic import Field
from scipy.spatial.transform import Rotation

from magmatch.data.formats.phones.phone_log import PhoneLog, Stream
from magmatch.data.trajectory import Trajectory
from magmatch.errors import DataFormatError, import_extra
from magmatch.number_text import many
from magmatch.settings import Settings
from magmatch.typing import Indices, Scalars, Vectors

log = logging.getLogger(__name__)

# Steps: peaks of the vertical acceleration below this frequency (Hz), so far apart (s), so high above the valleys
# beside them (m/s^2). People walk at 1.4 to 2.5 steps a second.
STEP_FREQUENCY, STEP_INTERVAL, STEP_PROMINENCE = 3.0, 0.35, 1.0
# Peaks further apart than this (s) are a stop, not a step.
LONGEST_STEP = 1.2
# Weinberg (2002), Analog Devices AN-602: a step is K (a_max - a_min)^(1/4) long; K in m^(3/4) s^(1/2), chosen on
# routes 1 to 3 of IPIN's training logs of 2023.
WEINBERG_FACTOR = 0.469
# Rest, at which the gyroscope's bias is learned: turning and acceleration within these (deg/s, m/s^2) of their slow
# parts. A phone held still in a hand trembles by 2 to 4 deg/s, so that VQF's 2 deg/s never hold (chosen on routes 1
# to 3 of IPIN's training logs of 2023, as is the next).
REST_TURNING_DEG, REST_ACCELERATION = 6.0, 1.0
# How well one such rest tells the bias, deg/s: the hand itself turns; VQF's 0.03 are for a table.
REST_BIAS_SD_DEG = 0.1
# Poses a second. Gyroscopes of phones read 50 to 400 times; a hand turns a degree in 10 ms.
RATE = 100.0
# Relative standard deviations: of Weinberg's factor between people (8 %, AN-602), and of one step beside it.
FACTOR_SD, STEP_SD = 0.08, 0.1
# Gravity turns as the gyroscope does. Both are compared over this time, about a step (s): less shows the steps'
# accelerations, more the gyroscope's drift. A walker's accelerometer tells gravity no better than this, rad.
COMPARED_OVER, GRAVITY_SD = 0.5, 0.05
# Turns that are this many times too large are nearer to deg/s than to rad/s.
TOO_FAR = float(np.sqrt(180 / np.pi))
WHAT_FOR = "dead reckoning"
# Bounds of what is taken for one walk: s, readings a second, and the longest gap that is not worth a word (s).
SPAN, SLOWEST, GAP = (2.0, 86_400.0), 15.0, 0.2


class DeadReckoningConfig(Settings):
    """Settings of `magmatch.phones.dead_reckon`."""

    # Ratio of the walker's step length to the average: true length of a path over the one found.
    step_scale: float = Field(default=1.0, ge=0.3, le=3)


@dataclass(frozen=True, eq=False, slots=True)
class Steps:
    """Steps between consecutive peaks of the vertical acceleration."""

    first: Indices  # (n,): rows between which each step was made
    last: Indices  # (n,)
    lengths: Scalars  # (n,), m: by Weinberg's rule

    def __len__(self) -> int:
        return len(self.lengths)

    def within(self, pieces: Indices) -> "Steps":
        """Those that begin and end in one piece; `pieces` numbers the rows."""
        is_whole = pieces[self.first] == pieces[self.last]
        return Steps(self.first[is_whole], self.last[is_whole], self.lengths[is_whole])

    def speed(self, n: int, rate: float) -> Scalars:
        """Speed of the walk at each of n rows, m/s: even within a step, 0 where none is made."""
        change = np.zeros(n + 1)
        speeds = self.lengths * rate / (self.last - self.first)
        np.add.at(change, self.first, speeds)
        np.add.at(change, self.last, -speeds)
        return np.maximum(np.cumsum(change)[:n], 0)


@dataclass(frozen=True, eq=False, slots=True)
class Odometry:
    """A walk by dead reckoning.

    Attributes
    ----------
    trajectory : Trajectory
        Of the phone, on the log's clock; starts at the origin with an arbitrary heading, at z = 0; drifts.
    steps : Steps
        The steps of the path.
    length_sd : float, m
        Standard deviation of the path's length: of the walker's factor and of single steps.
    """

    trajectory: Trajectory
    steps: Steps
    length_sd: float

    @property
    def length(self) -> float:
        """Length of the path, m."""
        return float(self.steps.lengths.sum())


def dead_reckon(phone: PhoneLog, config: DeadReckoningConfig | None = None) -> Odometry:
    """Path of a walk whose phone was held in front, from its accelerometer and gyroscope alone.

    Raises
    ------
    DataFormatError
        A sensor is missing or too slow, or no steps are found.

    Notes
    -----
    With each step, the position moves along the phone's heading by the step's length. A constant angle between phone
    and walking direction rotates the whole path; a changing angle bends it. Of a gap in which more than a step fits
    nothing is known: the path has no poses there, and goes on behind it as if the walker had stood still.
    """
    config = config or DeadReckoningConfig()
    acceleration, rate = usable(phone)
    times, stop = _even_times(phone, (acceleration, rate))
    felt, turning = acceleration.at(times), rate.at(times)
    _require_radians(phone, rate.source, turning, felt)
    orientations = attitude(turning, felt, RATE)
    steps = find_steps(orientations.apply(felt)[:, 2], RATE, config.step_scale).within(_pieces(times))
    if not len(steps):
        message = f"no step is found in {times[-1] - times[0]:.3g} s; expected a walk with the phone in the hand"
        raise DataFormatError(phone.path, message)
    speed = steps.speed(len(times), RATE)
    moves = heading(orientations) * (speed / RATE)[:, None]
    positions = np.zeros((len(times), 3))
    positions[1:, :2] = np.cumsum(moves[:-1], axis=0)
    length = float(steps.lengths.sum())
    by_step = STEP_SD * float(np.sqrt((steps.lengths**2).sum()))
    trajectory = Trajectory(times, positions, orientations)
    if 0 < stop - times[-1] <= 1 / RATE:  # the last reading rarely falls on an even time
        trajectory = _carried_on(trajectory, stop, moves[-1] * RATE, turning[-1])
    return Odometry(trajectory, steps, float(np.hypot(FACTOR_SD * length, by_step)))


def usable(phone: PhoneLog) -> tuple[Stream, Stream]:
    """Accelerometer and gyroscope of a log, if they can be those of a walk."""
    streams = phone.acceleration(WHAT_FOR), phone.require("rate", WHAT_FOR)
    span = min(s.times[-1] for s in streams) - max(s.times[0] for s in streams)
    if not SPAN[0] <= span <= SPAN[1]:
        message = f"the sensors share {span:.3g} s, expected a walk of {SPAN[0]:g} s to {SPAN[1] / 3600:g} h"
        raise DataFormatError(phone.path, message)
    for stream in streams:
        rate = 1 / float(np.median(np.diff(stream.times)))
        if rate < SLOWEST:
            message = f"{stream.source}: {rate:.3g} readings a second, expected at least {SLOWEST:g} for {WHAT_FOR}"
            raise DataFormatError(phone.path, message)
    return streams


def _require_radians(phone: PhoneLog, source: str, turning: Vectors, felt: Vectors) -> None:
    """Refuse a gyroscope by which gravity would turn much further than the accelerometer shows."""
    down = felt / np.maximum(np.linalg.norm(felt, axis=1, keepdims=True), 1e-9)
    n = round(COMPARED_OVER * RATE)
    starts = np.arange(0, len(down) - n + 1, n)
    # A direction that stands still turns by -w x g in the phone's axes; the median is the gyroscope's bias.
    turned = np.cross(down, turning - np.median(turning, axis=0)) * COMPARED_OVER
    shown, expected = (np.add.reduceat(v[: len(starts) * n], starts) / n for v in (down, turned))
    changes = np.diff(shown, axis=0), (expected[1:] + expected[:-1]) / 2
    by_gravity, by_gyroscope = (float(np.sqrt((change**2).sum(axis=1).mean())) for change in changes)
    if by_gyroscope > TOO_FAR * max(by_gravity, GRAVITY_SD):
        times = f"{by_gyroscope / max(by_gravity, GRAVITY_SD):.0f} times as far as gravity does in the accelerometer"
        message = f"{source}: turns {times}, expected rad/s; if it is in deg/s, multiply it by pi / 180"
        raise DataFormatError(phone.path, message)


def _even_times(phone: PhoneLog, streams: tuple[Stream, ...]) -> tuple[Scalars, float]:
    """Times at even steps that all sensors cover, none of them in a long gap, and where the sensors end."""
    start, stop = max(s.times[0] for s in streams), min(s.times[-1] for s in streams)
    times = np.asarray(start + np.arange(int((stop - start) * RATE) + 1) / RATE)
    for stream in streams:
        intervals = np.diff(stream.times)
        if intervals.max() > GAP:
            words = "%s: %s has %s, the longest %.3g s: turns and steps within are lost"
            n_gaps = int((intervals > GAP).sum())
            log.warning(words, phone.path, stream.source, many(n_gaps, "gap"), intervals.max())
        before = np.clip(np.searchsorted(stream.times, times) - 1, 0, len(intervals) - 1)
        is_between = (times > stream.times[before]) & (times < stream.times[before + 1])
        times = times[~(is_between & (intervals[before] > LONGEST_STEP))]
    if (n_pieces := _pieces(times)[-1] + 1) > 1:
        words = "each goes on where and as the one before it stopped, as if you had stood"
        log.warning("%s: the path is in %d pieces; %s", phone.path, n_pieces, words)
    return times, float(stop)


def _pieces(times: Scalars) -> Indices:
    """Numbers of the pieces between long gaps, counted from 0: (n,)."""
    return np.concatenate([[0], np.cumsum(np.diff(times) > LONGEST_STEP)])


def attitude(rate: Vectors, acceleration: Vectors, readings_per_second: float) -> Rotation:
    """Smoothed orientations of the phone at even times, to a frame whose z is up.

    From the gyroscope (rad/s) and the accelerometer (m/s^2, gravity included), phone's axes: VQF without its
    magnetometer, forward and back (Laidig and Seel 2023, 10.1016/j.inffus.2022.10.014). The bias of the gyroscope is
    estimated at rest only: while walking it would absorb the swing of the arm, which made paths of the IPIN logs two
    to four times worse.
    """
    vqf = import_extra("vqf", "dead reckoning", "odometry")
    settings = {
        "motionBiasEstEnabled": False, "restThGyr": REST_TURNING_DEG, "restThAcc": REST_ACCELERATION,
        "biasSigmaRest": REST_BIAS_SD_DEG,
    }  # fmt: skip
    found = vqf.offlineVQF(
        np.ascontiguousarray(rate), np.ascontiguousarray(acceleration), None, 1 / readings_per_second, settings
    )
    return Rotation.from_quat(found["quat6D"], scalar_first=True)


def find_steps(vertical: Scalars, rate: float, scale: float = 1.0) -> Steps:
    """Steps in the vertical acceleration (m/s^2, gravity taken off or not), ``rate`` times a second.

    Length ``scale K (a_max - a_min)^(1/4)`` of the low-passed acceleration within the step (Weinberg 2002).
    """
    # Imported here, since the import takes longer than localising a log that has poses.
    from scipy.signal import butter, find_peaks, sosfiltfilt

    filter_ = butter(2, STEP_FREQUENCY, fs=rate, output="sos")
    smooth = sosfiltfilt(filter_, vertical - np.median(vertical)) if len(vertical) > 20 else np.zeros(len(vertical))
    apart = max(1, round(STEP_INTERVAL * rate))
    peaks, _ = find_peaks(smooth, distance=apart, prominence=STEP_PROMINENCE)
    first, last = peaks[:-1], peaks[1:]
    is_step = last - first <= LONGEST_STEP * rate
    first, last = first[is_step], last[is_step]
    swings = np.array([np.ptp(smooth[i:j]) for i, j in zip(first, last, strict=True)])
    return Steps(first, last, scale * WEINBERG_FACTOR * swings**0.25)


def heading(orientations: Rotation) -> Vectors:
    """Horizontal direction in which a phone points, unit vectors: (n, 2).

    That of its upper end, or of its back if it is mostly held upright, as for a picture.
    """
    top, back = orientations.apply([0.0, 1.0, 0.0])[:, :2], orientations.apply([0.0, 0.0, -1.0])[:, :2]
    is_upright = np.linalg.norm(back, axis=1).mean() > 2 * np.linalg.norm(top, axis=1).mean()
    level = back if is_upright else top
    size = np.linalg.norm(level, axis=1, keepdims=True)
    return np.asarray(level / np.maximum(size, 1e-9))


def _carried_on(trajectory: Trajectory, stop: float, velocity: Scalars, turning: Scalars) -> Trajectory:
    """A pose more, at the last reading: moved and turned (m/s; rad/s, phone's axes) as at the last pose."""
    seconds = stop - trajectory.times[-1]
    last = trajectory.positions[-1] + [*(velocity * seconds), 0.0]
    turned = trajectory.orientations[-1] * Rotation.from_rotvec(turning * seconds)
    return Trajectory(
        np.append(trajectory.times, stop),
        np.vstack([trajectory.positions, last]),
        Rotation.concatenate([trajectory.orientations, turned]),
    )
