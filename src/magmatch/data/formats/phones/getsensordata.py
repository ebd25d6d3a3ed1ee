# SPDX-License-Identifier: BSD-3-Clause
"""Text logs of GetSensorData (LOPSI, CAR-CSIC): rows ``MAGN;app s;sensor s;x;y;z;accuracy`` under ``%`` lines."""

import re
from collections.abc import Collection, Iterator, Mapping, Sequence
from pathlib import Path

import numpy as np

from magmatch.data.formats.phones.phone_log import PER_UNIT, Sensor, Stream, stream_of
from magmatch.data.formats.phones.tagged_rows import lines_of, read_tagged
from magmatch.data.surveyed_points import SurveyedPoints
from magmatch.data.tables.number_marks import decimal_of_cells
from magmatch.data.tables.text_rows import split_row
from magmatch.data.units import CLOCKS_APART
from magmatch.errors import DataFormatError
from magmatch.typing import Indices, Matrix

APP = "GetSensorData"
_TAGS: Mapping[str, Sensor] = {"MAGN": "field", "ACCE": "acceleration", "GYRO": "rate"}
_NAMES = ("app time", "sensor time", "x", "y", "z")
# Points that the walker marked: ``POSI;app s;counter;latitude;longitude;floor;building``.
_POINT, _POINT_NAMES = "POSI", ("app time", "counter", "latitude", "longitude", "floor")
# The lines above the rows may name the columns: ``% MAGN: 'MAGN;AppTimestamp(s);SensorTimestamp(s);Mag_X(uT);...'``.
_NAMED = re.compile(r"\b(MAGN|ACCE|GYRO);([^'\"]*)")
_ROW = re.compile(rb"(?m)^(?:ACCE|GYRO|MAGN);\s*[-+\d.,]+;")


def begins_like(head: bytes) -> bool:
    """Whether a file begins like such a log."""
    return (head.startswith(b"%") and _ROW.search(head) is not None) or _ROW.match(head) is not None


def read(path: Path, raw: bytes, wanted: Collection[Sensor], *, recover: bool) -> dict[Sensor, Stream]:
    """Read the sensors that are wanted, on the app's clock.

    The app's times come in bursts; the sensors' own are even. So a row's time is its sensor's, moved by the median of
    what the app's clock is ahead: of all sensors together where they share a clock.
    """
    blocks = _read(path, raw, _TAGS, _NAMES, recover)
    ahead = {tag: float(np.median(block[:, 0] - block[:, 1])) for tag, (block, _) in blocks.items()}
    if ahead and max(ahead.values()) - min(ahead.values()) < CLOCKS_APART:
        ahead = dict.fromkeys(
            ahead, float(np.median(np.concatenate([b[:, 0] - b[:, 1] for b, _ in blocks.values()])))
        )
    streams = {}
    for tag, (block, numbers) in blocks.items():
        if (sensor := _TAGS[tag]) in wanted:
            values = block[:, 2:] * PER_UNIT[sensor]
            streams[sensor] = stream_of(path, f"{tag} rows", block[:, 1] + ahead[tag], values, numbers)
    return streams


def points(path: Path, raw: bytes, *, recover: bool) -> SurveyedPoints | None:
    """Read the points that the walker marked, which have the app's times only."""
    blocks = _read(path, raw, {_POINT}, _POINT_NAMES, recover)
    if _POINT not in blocks:
        return None
    block, lines = blocks[_POINT]
    floors = tuple(f"{floor:g}" for floor in np.unique(block[:, 4]))
    return SurveyedPoints.checked(path, f"{_POINT} rows", block[:, 0], block[:, 2:4], lines, floors, in_degrees=True)


def _read(
    path: Path, raw: bytes, tags: Collection[str], names: Sequence[str], recover: bool
) -> dict[str, tuple[Matrix, Indices]]:
    """Numbers of the rows with some tags, with the decimal mark of the whole log: that of its sensors' rows."""
    lines = lines_of(raw)
    _require_order(path, lines)
    decimal = decimal_of_cells(path, ((i, cells) for i, _, cells in _tagged(lines, _TAGS, len(_NAMES))), _NAMES)
    return read_tagged(path, _tagged(lines, tags, len(names)), names, decimal=decimal, recover=recover)


def _tagged(lines: Sequence[str], tags: Collection[str], n: int) -> Iterator[tuple[int, str, list[str]]]:
    """Line number, tag and first cells of the rows with some tags."""
    for i, line in enumerate(lines, start=1):
        tag, _, rest = line.partition(";")
        if tag in tags:
            yield i, tag, split_row(rest, ";")[:n]


def _require_order(path: Path, lines: Sequence[str]) -> None:
    """Refuse a log whose header names the columns in another order."""
    for i, line in enumerate(lines, start=1):
        if line.partition(";")[0] in _TAGS:
            return
        if line.startswith("%") and (found := _NAMED.search(line)):
            words = [word.strip() for word in found[2].split(";") if word.strip()][: len(_NAMES)]
            axes = [re.sub(r"\(.*", "", word).lower()[-1:] for word in words[2:]]
            if sorted(axes) == [*"xyz"] and (axes != [*"xyz"] or "sens" in words[0].lower()):
                message = f"expected {', '.join(_NAMES)} behind {found[1]}, found the columns {', '.join(words)}"
                raise DataFormatError(path, f"{message}; bring them into this order", line=i)
