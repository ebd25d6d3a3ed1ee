# SPDX-License-Identifier: BSD-3-Clause
"""`PhoneLog`: readings of a phone's sensors, each at its own times, whichever app wrote them."""

import logging
from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, Literal, get_args

import numpy as np

from magmatch.data.surveyed_points import SurveyedPoints
from magmatch.data.units import CLOCKS_APART, DAMAGED, TESLA_PER_UNIT
from magmatch.errors import DataFormatError
from magmatch.number_text import told
from magmatch.typing import Indices, Scalars, Vectors

logger = logging.getLogger(__name__)

# field: the magnetometer with the phone's own calibration; raw_field: without it. acceleration includes gravity.
Sensor = Literal["field", "raw_field", "acceleration", "linear_acceleration", "gravity", "rate"]
# What each is in, as apps write it, and how much of ours that is (T, m/s^2, rad/s).
PER_UNIT: dict[Sensor, float] = {of: TESLA_PER_UNIT["uT"] if "field" in of else 1.0 for of in get_args(Sensor)}
WORDS: dict[Sensor, str] = {
    "field": "magnetometer", "raw_field": "uncalibrated magnetometer", "acceleration": "accelerometer with gravity",
    "linear_acceleration": "accelerometer without gravity", "gravity": "gravity", "rate": "gyroscope",
}  # fmt: skip
# Readings (T, m/s^2, rad/s) beyond this are damage, stated in docs/formats.md; phones read up to 5 mT, 160 m/s^2 and
# 35 rad/s.
LARGEST = 1e5
STANDARD_GRAVITY = 9.80665  # m/s^2
# Median lengths of accelerations with gravity, in units of g: a phone in a hand is not in free fall.
WITH_GRAVITY = (0.7, 1.3)


@dataclass(frozen=True, eq=False, slots=True)
class Stream:
    """Readings of one sensor."""

    times: Scalars  # (n,), s: strictly increasing, on the log's clock
    values: Vectors  # (n, 3), T, m/s^2 or rad/s: in the phone's axes: x to the right, y up the screen, z out of it
    source: str  # the table or the kind of row it came from

    def __len__(self) -> int:
        return len(self.times)

    def at(self, times: Scalars) -> Vectors:
        """Values interpolated to other times, held at the ends: (k, 3)."""
        return np.column_stack([np.interp(times, self.times, axis) for axis in self.values.T])


@dataclass(frozen=True, eq=False, slots=True)
class PhoneLog:
    """Readings of a phone's sensors on one clock.

    Attributes
    ----------
    path : Path
        The file or folder.
    app : str
        The app that wrote it.
    streams : dict of Sensor to Stream
        The requested sensors that exist.
    points : SurveyedPoints, optional
        Points that the walker marked, if they were asked for and there are any.
    """

    path: Path
    app: str
    streams: Mapping[Sensor, Stream]
    points: SurveyedPoints | None = None

    def facts(self) -> list[dict[str, Any]]:
        """Source, sensor, count, rate and span of each stream, ready for JSON, as of the topics of a log."""
        facts: list[dict[str, Any]] = [
            {
                "name": stream.source, "type": WORDS[sensor], "count": len(stream),
                "rate": float(1 / np.median(np.diff(stream.times))) if len(stream) > 1 else None,
                "span": [float(stream.times[0]), float(stream.times[-1])],
            }
            for sensor, stream in self.streams.items()
        ]  # fmt: skip
        if (points := self.points) is not None:
            span = [float(points.times.min()), float(points.times.max())]
            floors = f"; floor {', '.join(points.floors)}" if points.floors else ""
            kind = f"surveyed points ({'latitude, longitude' if points.in_degrees else 'x, y in m'}{floors})"
            facts.append(
                {"name": points.source, "type": kind, "count": len(points.times), "rate": None, "span": span}
            )
        return facts

    def require(self, sensor: Sensor, what_for: str) -> Stream:
        """Readings of a sensor; DataFormatError where there are none."""
        if sensor not in self.streams:
            found = ", ".join(WORDS[name] for name in self.streams) or "none that is known"
            message = f"expected readings of the {WORDS[sensor]} for {what_for}; found sensors: {found}"
            raise DataFormatError(self.path, message)
        return self.streams[sensor]

    def acceleration(self, what_for: str) -> Stream:
        """Readings of the accelerometer with gravity, m/s^2; their sum if the app separates the two."""
        found = self.streams.get("acceleration")
        if found is None and {"linear_acceleration", "gravity"} <= self.streams.keys():
            linear, gravity = self.streams["linear_acceleration"], self.streams["gravity"]
            found = replace(linear, values=linear.values + gravity.at(linear.times))
        found = found or self.streams.get("linear_acceleration") or self.require("acceleration", what_for)
        length = float(np.median(np.linalg.norm(found.values, axis=1)))
        for unit in (1.0, STANDARD_GRAVITY):  # iPhones may write multiples of g
            if WITH_GRAVITY[0] < length * unit / STANDARD_GRAVITY < WITH_GRAVITY[1]:
                return found if unit == 1 else replace(found, values=found.values * unit)
        message = (
            f"expected accelerations with gravity (9.8 m/s^2 long) for {what_for}; {found.source} holds such of "
            f"{length:.3g}; record the accelerometer with gravity ('TotalAcceleration' or 'Gravity' too)"
        )
        raise DataFormatError(self.path, message)


def stream_of(path: Path, source: str, times: Scalars, values: Vectors, lines: Indices) -> Stream:
    """Readings in the order of their times; of equal times the first stays."""
    for name, column, bound in (("time", times, DAMAGED), *(("xyz"[k], v, LARGEST) for k, v in enumerate(values.T))):
        row = int(np.argmax(np.abs(column)))
        if abs(column[row]) > bound:
            message = f"expected numbers of phones (below {bound:g} in SI units), found {column[row]:.4g}"
            raise DataFormatError(path, message, line=int(lines[row]), column=name)
    behind = np.maximum.accumulate(times) - times
    if len(times) and behind.max() > CLOCKS_APART:
        row = int(np.argmax(behind > CLOCKS_APART))
        message = (
            f"time runs backward by {behind[row]:.4g} s: {told(times[row])} s; two logs joined, a clock that was "
            "set, or rows in disorder (sort them by time)?"
        )
        raise DataFormatError(path, message, line=int(lines[row]))
    distinct, kept = np.unique(times, return_index=True)
    n_late, n_equal = int((behind > 0).sum()), len(times) - len(distinct)
    if n_late or n_equal:
        words = "%s: of the rows of %s %d stand after later ones (sorted) and %d repeat a time (left out)"
        logger.warning(words, path, source, n_late, n_equal)
    return Stream(distinct, values[kept], source)
