# SPDX-License-Identifier: BSD-3-Clause
"""Text logs of XYZ10's Indoor Location Competition: rows ``Unix ms, TYPE_SENSOR, values``, separated by tabs."""

import re
from collections.abc import Collection, Iterator, Mapping, Sequence
from pathlib import Path

from magmatch.data.formats.phones.phone_log import PER_UNIT, Sensor, Stream, stream_of
from magmatch.data.formats.phones.tagged_rows import Row, lines_of, read_tagged
from magmatch.data.surveyed_points import SurveyedPoints
from magmatch.data.tables.text_rows import split_row
from magmatch.data.units import UNITS_PER_SECOND
from magmatch.typing import Indices, Matrix

APP = "XYZ10"
# Uncalibrated readings have the phone's own bias behind them, and most rows an accuracy: neither is used.
_TAGS: Mapping[str, Sensor] = {
    "TYPE_MAGNETIC_FIELD": "field", "TYPE_MAGNETIC_FIELD_UNCALIBRATED": "raw_field",
    "TYPE_ACCELEROMETER": "acceleration", "TYPE_LINEAR_ACCELERATION": "linear_acceleration",
    "TYPE_GRAVITY": "gravity", "TYPE_GYROSCOPE": "rate",
}  # fmt: skip
_POINT = "TYPE_WAYPOINT"
_HEAD = re.compile(rb"(?m)^\d{10,}\tTYPE_[A-Z0-9_]+\t")
_FLOOR = re.compile(rb"(?m)^#.*\tFloorName:([^\t\r\n]+)")
# Where a row follows another without a line end between, as in some of the published files.
_JOINED = re.compile(r"(?=\d{13}\tTYPE_)")
MS = UNITS_PER_SECOND["ms"]


def begins_like(head: bytes) -> bool:
    """Whether a file begins like such a log."""
    return (head.startswith(b"#") and _HEAD.search(head) is not None) or _HEAD.match(head) is not None


def read(path: Path, raw: bytes, wanted: Collection[Sensor], *, recover: bool) -> dict[Sensor, Stream]:
    """Read the sensors that are wanted, on the clock of the phone."""
    blocks = _read(path, raw, {tag for tag, sensor in _TAGS.items() if sensor in wanted}, "xyz", recover)
    return {
        _TAGS[tag]: stream_of(path, f"{tag} rows", block[:, 0] / MS, block[:, 1:] * PER_UNIT[_TAGS[tag]], lines)
        for tag, (block, lines) in blocks.items()
    }


def points(path: Path, raw: bytes, *, recover: bool) -> SurveyedPoints | None:
    """Read the points that the walker marked: x and y in the frame of the floor's plan."""
    block, lines = _read(path, raw, {_POINT}, "xy", recover).get(_POINT, (None, None))
    if block is None or lines is None:
        return None
    floors = tuple(name.decode("utf-8", "replace") for name in _FLOOR.findall(raw)[:1])
    return SurveyedPoints.checked(path, f"{_POINT} rows", block[:, 0] / MS, block[:, 1:], lines, floors)


def _read(
    path: Path, raw: bytes, tags: Collection[str], axes: str, recover: bool
) -> dict[str, tuple[Matrix, Indices]]:
    """Times and values of the rows with some tags."""
    rows = _tagged(lines_of(raw), tags, len(axes))
    return read_tagged(path, rows, ("time", *axes), decimal=None, recover=recover)


def _tagged(lines: Sequence[str], tags: Collection[str], n: int) -> Iterator[Row]:
    """Rows with some tags: time and the first values."""
    for i, line in enumerate(lines, start=1):
        if line.startswith("#"):
            continue
        for row in _JOINED.split(line) if line.count("\tTYPE_") > 1 else (line,):
            time, _, rest = row.partition("\t")
            tag, *cells = split_row(rest, "\t")
            if tag in tags:
                yield i, tag, [time, *cells[:n]]
