# SPDX-License-Identifier: BSD-3-Clause
"""Text logs of phones, each row named after its sensor: of GetSensorData and of XYZ10's Indoor Location Competition.

GetSensorData (LOPSI, CAR-CSIC) writes ``MAGN;app s;sensor s;x;y;z;accuracy`` under ``%`` lines, XYZ10
``Unix ms, TYPE_SENSOR, values`` between tabs under ``#`` lines.
"""

import re
from codecs import BOM_UTF8
from collections.abc import Callable, Collection, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from magmatch.data.formats.phones.phone_log import PER_UNIT, Sensor, Stream, stream_of
from magmatch.data.surveyed_points import SurveyedPoints
from magmatch.data.tables.number_marks import Decimal, decimal_of_cells
from magmatch.data.tables.numbers import NumberReader
from magmatch.data.tables.text_rows import split_row
from magmatch.data.units import CLOCKS_APART, MEBI, UNITS_PER_SECOND
from magmatch.errors import DataFormatError
from magmatch.typing import Indices, Matrix

# A row: the line it stands on, counted from 1, its sensor, and a cell for each of the names.
Row = tuple[int, str, Sequence[str]]
# By sensor: its numbers (n, k), the first of which are times, and the lines they stand on.
Blocks = dict[str, tuple[Matrix, Indices]]

_GETSENSORDATA: Mapping[str, Sensor] = {"MAGN": "field", "ACCE": "acceleration", "GYRO": "rate"}
_NAMES = ("app time", "sensor time", "x", "y", "z")
# Points that the walker marked: ``POSI;app s;counter;latitude;longitude;floor;building``.
_POSI, _POSI_NAMES = "POSI", ("app time", "counter", "latitude", "longitude", "floor")
# The lines above the rows may name the columns: ``% MAGN: 'MAGN;AppTimestamp(s);SensorTimestamp(s);Mag_X(uT);...'``.
_NAMED = re.compile(r"\b(MAGN|ACCE|GYRO);([^'\"]*)")

# Uncalibrated readings have the phone's own bias behind them, and most rows an accuracy: neither is used.
_XYZ10: Mapping[str, Sensor] = {
    "TYPE_MAGNETIC_FIELD": "field", "TYPE_MAGNETIC_FIELD_UNCALIBRATED": "raw_field",
    "TYPE_ACCELEROMETER": "acceleration", "TYPE_LINEAR_ACCELERATION": "linear_acceleration",
    "TYPE_GRAVITY": "gravity", "TYPE_GYROSCOPE": "rate",
}  # fmt: skip
_WAYPOINT = "TYPE_WAYPOINT"
_FLOOR = re.compile(rb"(?m)^#.*\tFloorName:([^\t\r\n]+)")
# Where a row follows another without a line end between, as in some of the published files.
_JOINED = re.compile(r"(?=\d{13}\tTYPE_)")
_MS = UNITS_PER_SECOND["ms"]


@dataclass(frozen=True, slots=True)
class TextLog:
    """An app's text log: how it begins, and how its sensors and the walker's points are read from its bytes."""

    app: str
    comment: bytes  # how lines above the rows begin
    row: re.Pattern[bytes]
    read: Callable[[Path, bytes, Collection[Sensor], bool], dict[Sensor, Stream]]
    points: Callable[[Path, bytes, bool], SurveyedPoints | None]


def text_log_of(head: bytes) -> TextLog | None:
    """Tell whose text log a file begins like."""
    text = head[:MEBI].removeprefix(BOM_UTF8)
    logs = (log for log in _LOGS if log.row.match(text) or (text.startswith(log.comment) and log.row.search(text)))
    return next(logs, None)


def read_tagged(
    path: Path, rows: Iterable[Row], names: Sequence[str], digits: int = 0, *, decimal: Decimal | None, recover: bool
) -> Blocks:
    """Read the numbers of each sensor of which there are rows.

    Times count units of 10**-digits s. `decimal` counts where the numbers leave their decimal mark in doubt. A faulty
    row is named, or left out and counted where recovering.
    """
    held = [(line, [tag, *cells]) for line, tag, cells in rows]
    if not held:
        return {}
    mark = decimal_of_cells(path, ((line, cells[1:]) for line, cells in held), names, decimal)
    places = {name: k for k, name in enumerate(names, start=1)}
    reader = NumberReader(
        path, ("sensor", *names), places, mark, {names[0]: digits}, words={"sensor": 0}, recover=recover
    )
    block, lines, words = reader.read(held)
    tags = np.array(words["sensor"])
    return {tag: (block[tags == tag], lines[tags == tag]) for tag in dict.fromkeys(words["sensor"])}


def _lines_of(raw: bytes) -> list[str]:
    """Lines of a log: UTF-8, or plain ASCII rows below a header of whatever the phone's language writes."""
    try:
        text = raw.decode("utf-8-sig")
    except UnicodeDecodeError:
        text = raw.decode("latin-1")
    return re.split("\r\n?|\n", text)


def _getsensordata(path: Path, raw: bytes, wanted: Collection[Sensor], recover: bool) -> dict[Sensor, Stream]:
    """Sensors on the app's clock.

    The app's times come in bursts; the sensors' own are even. So a row's time is its sensor's, moved by the median of
    what the app's clock is ahead: of all sensors together where they share a clock.
    """
    blocks = _getsensordata_blocks(path, raw, _GETSENSORDATA, _NAMES, recover)
    behind = {tag: block[:, 0] - block[:, 1] for tag, (block, _) in blocks.items()}
    ahead = {tag: float(np.median(one)) for tag, one in behind.items()}
    if ahead and max(ahead.values()) - min(ahead.values()) < CLOCKS_APART:
        ahead = dict.fromkeys(ahead, float(np.median(np.concatenate([*behind.values()]))))
    return {
        sensor: stream_of(path, f"{tag} rows", block[:, 1] + ahead[tag], block[:, 2:] * PER_UNIT[sensor], lines)
        for tag, (block, lines) in blocks.items()
        if (sensor := _GETSENSORDATA[tag]) in wanted
    }


def _getsensordata_points(path: Path, raw: bytes, recover: bool) -> SurveyedPoints | None:
    """Points, which have the app's times only."""
    blocks = _getsensordata_blocks(path, raw, {_POSI}, _POSI_NAMES, recover)
    if _POSI not in blocks:
        return None
    block, lines = blocks[_POSI]
    floors = tuple(f"{floor:g}" for floor in np.unique(block[:, 4]))
    return SurveyedPoints.checked(path, f"{_POSI} rows", block[:, 0], block[:, 2:4], lines, floors, in_degrees=True)


def _getsensordata_blocks(
    path: Path, raw: bytes, tags: Collection[str], names: Sequence[str], recover: bool
) -> Blocks:
    """Numbers of the rows with some tags, with the decimal mark of the whole log: that of its sensors' rows."""
    lines = _lines_of(raw)
    _require_order(path, lines)

    def tagged(tags: Collection[str], n: int) -> Iterator[Row]:
        for i, line in enumerate(lines, start=1):
            tag, _, rest = line.partition(";")
            if tag in tags:
                yield i, tag, split_row(rest, ";")[:n]

    decimal = decimal_of_cells(path, ((i, cells) for i, _, cells in tagged(_GETSENSORDATA, len(_NAMES))), _NAMES)
    return read_tagged(path, tagged(tags, len(names)), names, decimal=decimal, recover=recover)


def _require_order(path: Path, lines: Sequence[str]) -> None:
    """Refuse a log whose header names the columns in another order."""
    for i, line in enumerate(lines, start=1):
        if line.partition(";")[0] in _GETSENSORDATA:
            return
        if line.startswith("%") and (found := _NAMED.search(line)):
            words = [word.strip() for word in found[2].split(";") if word.strip()][: len(_NAMES)]
            axes = [re.sub(r"\(.*", "", word).lower()[-1:] for word in words[2:]]
            if sorted(axes) == [*"xyz"] and (axes != [*"xyz"] or "sens" in words[0].lower()):
                message = f"expected {', '.join(_NAMES)} behind {found[1]}, found the columns {', '.join(words)}"
                raise DataFormatError(path, f"{message}; bring them into this order", line=i)


def _xyz10(path: Path, raw: bytes, wanted: Collection[Sensor], recover: bool) -> dict[Sensor, Stream]:
    """Sensors on the clock of the phone."""
    tags = {tag for tag, sensor in _XYZ10.items() if sensor in wanted}
    blocks = read_tagged(path, _xyz10_rows(raw, tags, 3), ("time", *"xyz"), decimal=None, recover=recover)
    return {
        _XYZ10[tag]: stream_of(path, f"{tag} rows", block[:, 0] / _MS, block[:, 1:] * PER_UNIT[_XYZ10[tag]], lines)
        for tag, (block, lines) in blocks.items()
    }


def _xyz10_points(path: Path, raw: bytes, recover: bool) -> SurveyedPoints | None:
    """Points: x and y in the frame of the floor's plan."""
    rows = _xyz10_rows(raw, {_WAYPOINT}, 2)
    blocks = read_tagged(path, rows, ("time", *"xy"), decimal=None, recover=recover)
    if _WAYPOINT not in blocks:
        return None
    block, lines = blocks[_WAYPOINT]
    floors = tuple(name.decode("utf-8", "replace") for name in _FLOOR.findall(raw)[:1])
    return SurveyedPoints.checked(path, f"{_WAYPOINT} rows", block[:, 0] / _MS, block[:, 1:], lines, floors)


def _xyz10_rows(raw: bytes, tags: Collection[str], n: int) -> Iterator[Row]:
    """Rows with some tags: time and the first values."""
    for i, line in enumerate(_lines_of(raw), start=1):
        if line.startswith("#"):
            continue
        for row in _JOINED.split(line) if line.count("\tTYPE_") > 1 else (line,):
            time, _, rest = row.partition("\t")
            tag, *cells = split_row(rest, "\t")
            if tag in tags:
                yield i, tag, [time, *cells[:n]]


_LOGS = (
    TextLog(
        "GetSensorData",
        b"%",
        re.compile(rb"(?m)^(?:ACCE|GYRO|MAGN);\s*[-+\d.,]+;"),
        _getsensordata,
        _getsensordata_points,
    ),
    TextLog("XYZ10", b"#", re.compile(rb"(?m)^\d{10,}\tTYPE_[A-Z0-9_]+\t"), _xyz10, _xyz10_points),
)
