# SPDX-License-Identifier: BSD-3-Clause
"""Text logs of GetSensorData (LOPSI, CAR-CSIC): rows ``MAGN;app s;sensor s;x;y;z;accuracy`` under ``%`` lines."""

import re
from collections.abc import Collection, Mapping
from pathlib import Path

import numpy as np

from magmatch.data.formats.phones.phone_log import PER_UNIT, Sensor, Stream, SurveyedPoints, stream_of
from magmatch.data.formats.phones.tagged_rows import TaggedRows, lines_of

APP = "GetSensorData"
_TAGS: Mapping[str, Sensor] = {"MAGN": "field", "ACCE": "acceleration", "GYRO": "rate"}
_NAMES = ("app time", "sensor time", "x", "y", "z")
# Points that the walker marked: ``POSI;app s;counter;latitude;longitude;floor;building``.
_POINT, _POINT_NAMES = "POSI", ("app time", "counter", "latitude", "longitude", "floor")
_ROW = re.compile(rb"(?m)^(?:ACCE|GYRO|MAGN);\s*[-+\d.]+;")
# Sensors whose clocks differ by no more than this from the app's share one clock, s.
ONE_CLOCK = 1.0


def is_getsensordata(head: bytes) -> bool:
    """Whether a file begins like such a log."""
    return (head.startswith(b"%") and _ROW.search(head) is not None) or _ROW.match(head) is not None


def read_getsensordata(path: Path, raw: bytes, wanted: Collection[Sensor], *, recover: bool) -> dict[Sensor, Stream]:
    """Read the sensors that are wanted, on the app's clock.

    The app's times come in bursts; the sensors' own are even. So a row's time is its sensor's, moved by the median of
    what the app's clock is ahead: of all sensors together where they share a clock.
    """
    rows = TaggedRows(path, _NAMES, recover=recover)
    blocks = _take(rows, raw, _TAGS).blocks()
    ahead = {tag: float(np.median(block[:, 0] - block[:, 1])) for tag, (block, _) in blocks.items()}
    if ahead and max(ahead.values()) - min(ahead.values()) < ONE_CLOCK:
        ahead = dict.fromkeys(
            ahead, float(np.median(np.concatenate([b[:, 0] - b[:, 1] for b, _ in blocks.values()])))
        )
    streams = {}
    for tag, (block, lines) in blocks.items():
        if (sensor := _TAGS[tag]) in wanted:
            values = block[:, 2:] * PER_UNIT[sensor]
            streams[sensor] = stream_of(path, f"{tag} rows", block[:, 1] + ahead[tag], values, lines)
    return streams


def points_of_getsensordata(path: Path, raw: bytes, *, recover: bool) -> SurveyedPoints | None:
    """Read the points that the walker marked, which have the app's times only."""
    blocks = _take(TaggedRows(path, _POINT_NAMES, recover=recover), raw, (_POINT,)).blocks()
    if _POINT not in blocks:
        return None
    block, lines = blocks[_POINT]
    floors = tuple(f"{floor:g}" for floor in np.unique(block[:, 4]))
    return SurveyedPoints.checked(path, f"{_POINT} rows", block[:, 0], block[:, 2:4], lines, floors, in_degrees=True)


def _take(rows: TaggedRows, raw: bytes, tags: Collection[str]) -> TaggedRows:
    """Collect the rows with some tags."""
    for i, line in enumerate(lines_of(raw), start=1):
        tag, _, rest = line.partition(";")
        if tag in tags:
            rows.take(tag, i, rest.split(";")[: len(rows.names)])
    return rows
