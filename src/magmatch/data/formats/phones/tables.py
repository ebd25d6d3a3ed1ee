# SPDX-License-Identifier: BSD-3-Clause
"""Tables of phone apps, told by their headers: phyphox, AndroSensor, Sensor Logger, and Android's own fields."""

import re
from collections.abc import Collection, Mapping
from dataclasses import dataclass
from math import isclose
from pathlib import Path

import numpy as np

from magmatch.data.formats.phones.phone_log import PER_UNIT, WORDS, Sensor, Stream, stream_of
from magmatch.data.formats.phones.text_logs import read_tagged
from magmatch.data.tables.header_names import header_of
from magmatch.data.tables.number_marks import decimal_of_cells
from magmatch.data.tables.table import Table, Wanted, read_table
from magmatch.data.tables.text import text_lines
from magmatch.data.tables.text_rows import Rows, listed, rows_of
from magmatch.data.units import DIGITS_OF_SECOND, METRE_PER_UNIT, TimeUnit
from magmatch.errors import DataFormatError
from magmatch.typing import Indices, Matrix, Scalars

# What the tables are called, in the order in which they are preferred where two hold one sensor.
MEMBERS: Mapping[str, Sensor | None] = {
    "magnetometer": "field",
    "raw data": None,
    "totalacceleration": "acceleration",
    "accelerometer": None,  # without gravity where Sensor Logger wrote it
    "accelerometeruncalibrated": "acceleration",
    "gyroscope": "rate",
    "gravity": "gravity",
    "linear accelerometer": "linear_acceleration",
    "linear acceleration": "linear_acceleration",
    "magnetometeruncalibrated": "raw_field",
    "magnetometer uncalibrated": "raw_field",
}
AXES = ("x", "y", "z")
# Names of phyphox and AndroSensor: the sensor, an axis and the unit ("Magnetic field x (uT)", or "X (uT)").
_PHYPHOX = re.compile(r"(?P<what>.*?)\s*\b(?P<axis>[xyz]) \((?P<unit>[^()]*)\)")
_UNITS: Mapping[str, Sensor] = {
    "µt": "field", "μt": "field", "ut": "field", "m/s^2": "acceleration", "m/s²": "acceleration", "rad/s": "rate",
}  # fmt: skip
# Of these two apps: how a table calls its times, and what they are in.
_TIMES: Mapping[str, tuple[Collection[str], TimeUnit]] = {
    "phyphox": (("time (s)",), "s"), "AndroSensor": (("time since start in ms", "time since start (ms)"), "ms"),
}  # fmt: skip
# phyphox writes names in the phone's language, its times into the first column: told by their unit, like the sensors.
_TRANSLATED_TIME = re.compile(r"[^\W\d_]{2,} \(s\)")
# What accelerations without gravity are called there, and gravity alone.
_WITHOUT_GRAVITY, _GRAVITY = ("linear", "lineal", "linéaire", "ohne g"), ("gravi", "schwerkraft")
_ELAPSED = "seconds_elapsed"  # of Sensor Logger
_ANDROID_TIME = "event.timestamp"
_ANDROID_SENSOR = ("event.sensor", "event.sensor.type", "event.sensor.name", "sensor", "sensor_type", "type", "name")
_ANDROID_VALUE = re.compile(r"(?:event\.)?values?[\[_.]?([0-2])\]?|(?:event\.)?([xyz])")
# Numbers of sensors in Android.
_ANDROID_TYPES: Mapping[str, Sensor] = {
    "1": "acceleration", "2": "field", "4": "rate", "9": "gravity", "10": "linear_acceleration", "14": "raw_field",
}  # fmt: skip


@dataclass(frozen=True, slots=True)
class Columns:
    """The columns of a table: `sensors` holds the names of x, y and z, `tag` that of a sensor's name."""

    app: str
    time: str
    sensors: dict[Sensor, tuple[str, ...]]
    tag: str = ""


def is_phone_header(line: str) -> bool:
    """Whether a header is that of a phone's table."""
    return bool(line) and columns_of(_cells(line), "") is not None


def says_its_sensor(line: str, stem: str) -> bool:
    """Whether header and name of a table among others say that it is one of a sensor known here."""
    columns = columns_of(_cells(line), stem) if line else None
    return columns is not None and bool(columns.app in _TIMES or columns.tag or sensor_named(stem))


def read_table_streams(
    place: Path, raw: bytes, wanted: Collection[Sensor], *, recover: bool
) -> tuple[str, dict[Sensor, Stream]]:
    """Name the app and read the sensors of a table that are wanted."""
    lines = text_lines(place, raw)
    stem = stem_of(place.name)
    rows = rows_of(place, lines, lambda _, names: columns_of([name.lower() for name in names], stem) is not None)
    first = rows.at[0] if rows.at else 0
    names = _cells(lines[first])
    columns = columns_of(names, stem)
    if columns is None:
        message = "expected a phone's table (phyphox, AndroSensor, Sensor Logger, Android); found columns"
        raise DataFormatError(place, f"{message} {listed(names)}", line=first + 1)
    if columns.tag:
        return columns.app, _tagged(place, rows, columns, wanted, recover=recover)
    streams = {}
    for sensor, axes in columns.sensors.items():
        if sensor not in wanted:
            continue
        # One table of several sensors has cells without a number wherever one of them is slower.
        table = _read(place, lines, columns, axes, recover=recover or len(columns.sensors) > 1)
        times = table.columns[columns.time]
        values = table.stack(*axes) * PER_UNIT[sensor]
        streams[sensor] = stream_of(place, place.name, times, values, table.line_numbers)
    return columns.app, streams


def _read(place: Path, lines: list[str], columns: Columns, axes: tuple[str, ...], *, recover: bool) -> Table:
    """Read times, in s, and axes of a table."""
    names = [columns.time, *axes, *([_ELAPSED] if columns.app == "Sensor Logger" else [])]

    def read(digits: int) -> Table:
        table = read_table(place, Wanted(names, digits={columns.time: digits}, recover=recover), lines)
        table.require(names)
        return table

    if columns.app in _TIMES:
        return read(DIGITS_OF_SECOND[_TIMES[columns.app][1]])
    assumed = 9 if columns.app == "Sensor Logger" else 0
    table = read(assumed)  # their unit is told by all of them
    times = table.columns[columns.time]
    digits = _digits_beside(place, times, table.columns[_ELAPSED]) if assumed else _digits_of_times(times)
    return table if digits == assumed else read(digits)


def columns_of(names: list[str], stem: str) -> Columns | None:
    """Tell the columns of a table by their names (lower case) and the table's; None if it is no phone's."""
    if _ELAPSED in names and "time" in names:
        of_table: Sensor = MEMBERS.get(stem) or (
            "linear_acceleration" if stem == "accelerometer" else sensor_named(stem) or "field"
        )
        return Columns("Sensor Logger", "time", {of_table: AXES})
    if _ANDROID_TIME in names:
        return _android(names, stem)
    sensors: dict[Sensor, tuple[str, ...]] = {}
    for name in names:
        found = _PHYPHOX.fullmatch(name)
        sensor = _UNITS.get(found["unit"]) if found else None
        if found and sensor:
            what, unit = found["what"], found["unit"]
            axes = tuple(f"{what} {a} ({unit})".strip() for a in AXES)
            sensors.setdefault(_variant(sensor, f"{what} {stem}"), axes)
    app, time = _clock_of(names)
    return Columns(app, time, sensors) if sensors and app else None


def _clock_of(names: list[str]) -> tuple[str, str]:
    """Tell phyphox or AndroSensor by its column of times, and that column; empty where there is none."""
    for app, (times, _) in _TIMES.items():
        if time := next((name for name in names if name in times), ""):
            return app, time
    is_survey = any(unit in METRE_PER_UNIT for unit in header_of(names).units.values())
    return ("phyphox", names[0]) if _TRANSLATED_TIME.fullmatch(names[0]) and not is_survey else ("", "")


def _android(names: list[str], stem: str) -> Columns | None:
    """Columns named after the fields of Android's SensorEvent."""
    axes: dict[str, str] = {}
    for name in names:
        if found := _ANDROID_VALUE.fullmatch(name):
            axes.setdefault(found[2] or AXES[int(found[1])], name)
    if len(axes) < len(AXES):
        return None
    tag = next((name for name in _ANDROID_SENSOR if name in names), "")
    sensor = sensor_named(stem) or "field"
    return Columns("Android", _ANDROID_TIME, {sensor: tuple(axes[a] for a in AXES)}, tag)


def sensor_named(text: str) -> Sensor | None:
    """Tell the sensor that a word, or Android's number, stands for."""
    word = text.strip().strip("'\"").lower()
    kinds: Mapping[str, Sensor] = {
        "mag": "field", "linear": "linear_acceleration", "gravity": "gravity", "acc": "acceleration", "gyr": "rate",
    }  # fmt: skip
    plain = next((sensor for part, sensor in kinds.items() if part in word), None)
    if plain == "rate" and "uncal" in word:
        return None
    return _ANDROID_TYPES.get(word) or (plain and _variant(plain, word))


def _variant(sensor: Sensor, words: str) -> Sensor:
    """The sensor itself, or what is left of it without calibration or gravity."""
    if sensor == "field" and "uncal" in words:
        return "raw_field"
    if sensor == "acceleration" and words.startswith(_GRAVITY):
        return "gravity"
    is_linear = sensor == "acceleration" and any(word in words for word in _WITHOUT_GRAVITY)
    return "linear_acceleration" if is_linear else sensor


def _digits_of_times(times: Scalars) -> int:
    """Android's times are in 10**-digits s, told by how far apart they are: sensors read at 1 to 1000 Hz."""
    interval = float(np.median(np.abs(np.diff(times)))) if len(times) > 1 else 0.0
    return next((digits for digits in (9, 6, 3) if interval >= 10.0**digits / 1e3), 0)


def _digits_beside(place: Path, times: Scalars, elapsed: Scalars) -> int:
    """Sensor Logger's times, read as ns, are in 10**-digits s: ns, unless the seconds beside them say otherwise.

    Other programs save them in other units, and round them.
    """
    steps, is_forward = np.diff(times), np.diff(elapsed) >= 0  # not where a second log begins
    span, expected = float(steps[is_forward].sum()), float(np.diff(elapsed)[is_forward].sum())
    if expected == 0:
        return 9
    fits = (digits for digits in (9, 6, 3, 0) if isclose(span * 10.0 ** (9 - digits), expected, rel_tol=0.1))
    digits = next(fits, None)
    if digits is None and steps.min() < 0:
        return 9  # a clock that was set, which is named with its line
    n_times, n_elapsed = len(np.unique(times)), len(np.unique(elapsed))
    if digits is None or 2 * n_times < n_elapsed:
        message = (
            f"expected times as {_ELAPSED} says, {n_elapsed} in {expected:.4g} s; found {n_times} in {span:.4g} s "
            "(if in ns): rounded, by a spreadsheet? Use the file as the app exported it"
        )
        raise DataFormatError(place, message, column="time")
    return digits


def _tagged(
    place: Path, rows: Rows, columns: Columns, wanted: Collection[Sensor], *, recover: bool
) -> dict[Sensor, Stream]:
    """Rows of several sensors in one table, each named in its row."""
    names = _cells(rows.lines[rows.at[0]])
    (axes,) = columns.sensors.values()
    kinds, k = (columns.time, *axes), names.index(columns.tag)
    used = [names.index(name) for name in kinds]
    cells = dict(list(rows.cells())[1:])
    picked = {i: [row[k] if k < len(row) else "" for k in used] for i, row in cells.items()}
    decimal = decimal_of_cells(place, picked.items(), kinds)
    named = ((i, sensor_named(row[k]) if k < len(row) else None) for i, row in cells.items())
    held = [(i, str(sensor), picked[i]) for i, sensor in named if sensor in wanted]

    def read(digits: int) -> dict[str, tuple[Matrix, Indices]]:
        return read_tagged(place, held, kinds, digits, decimal=decimal, recover=recover)

    found = read(0)
    longest = max((block[:, 0] for block, _ in found.values()), key=len, default=np.zeros(0))
    if digits := _digits_of_times(longest):
        found = read(digits)
    streams = {}
    for sensor in (sensor for sensor in wanted if sensor in found):
        block, numbers = found[sensor]
        values = block[:, 1:] * PER_UNIT[sensor]
        streams[sensor] = stream_of(place, f"{place.name} ({WORDS[sensor]})", block[:, 0], values, numbers)
    return streams


def stem_of(name: str) -> str:
    """A table's name without folder and endings, lower case."""
    return name.replace("\\", "/").rsplit("/", 1)[-1].lower().removesuffix(".gz").removesuffix(".csv")


def _cells(line: str) -> list[str]:
    """Names of columns, lower case."""
    mark = next((mark for mark in ("\t", ";", ",") if mark in line), ",")
    return [cell.strip().strip("'\"").strip() for cell in line.lower().split(mark)]
