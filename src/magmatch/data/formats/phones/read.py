# SPDX-License-Identifier: BSD-3-Clause
"""`read_phone_log`: a phone's log in, its sensors out."""

import logging
from collections.abc import Collection
from dataclasses import replace
from pathlib import Path
from typing import get_args

import numpy as np

from magmatch.data.formats.format import SurveyFormat
from magmatch.data.formats.load_trajectory import with_poses
from magmatch.data.formats.phones.containers import opened_tables
from magmatch.data.formats.phones.metadata import with_metadata
from magmatch.data.formats.phones.phone_log import PhoneLog, Sensor, Stream
from magmatch.data.formats.phones.tables import MEMBERS, read_table_streams, stem_of
from magmatch.data.formats.phones.text_logs import text_log_of
from magmatch.data.formats.recording import Recording
from magmatch.data.surveyed_points import SurveyedPoints
from magmatch.data.tables.text import damage_told
from magmatch.data.trajectory import Trajectory
from magmatch.data.units import TESLA_PER_UNIT, unusual_size
from magmatch.errors import DataFormatError

logger = logging.getLogger(__name__)

EVERY: tuple[Sensor, ...] = get_args(Sensor)


def read_phone_log(
    path: str | Path, wanted: Collection[Sensor] = EVERY, *, recover: bool = False, with_points: bool = False
) -> PhoneLog:
    """Read the sensors of a phone's log, in tesla, m/s^2, rad/s and seconds.

    Parameters
    ----------
    path : path
        An app's export, recognised by content: a table, a text log, or a folder or zip archive of tables.
    wanted : collection of Sensor
        Those to read; others cost no time.
    recover : bool
        Leave out rows without valid numbers, and log how many, instead of refusing (`DataFormatError`).
    with_points : bool
        Read the points that the walker marked, too.
    """
    streams: dict[Sensor, Stream] = {}
    apps: list[str] = []
    points: SurveyedPoints | None = None
    with damage_told(path, "zip archive"), opened_tables(path) as tables:
        for place, read in tables.items():
            hint = MEMBERS.get(stem_of(place.name))
            if (hint and hint not in wanted) or set(wanted) <= streams.keys():
                continue
            raw = read()
            if (text := text_log_of(raw)) is not None:
                app, found = text.app, text.read(place, raw, wanted, recover)
                points = text.points(place, raw, recover) if with_points else None
            else:
                app, found = read_table_streams(place, raw, wanted, recover=recover)
            streams = found | streams
            apps.append(app)
        told = with_metadata(Path(path), apps[0] if apps else "", streams)
    return PhoneLog(Path(path), apps[0] if apps else "unknown", told, points)


def read_phone_recording(
    path: str | Path,
    layout: SurveyFormat,
    sensor: Sensor | None = None,
    trajectory: Trajectory | None = None,
    log: PhoneLog | None = None,
) -> Recording:
    """Join a magnetometer of a phone, by default its calibrated one, with poses: given, or of the layout's file.

    The log, if it is not given, is read, with the walker's points if they can be.
    """
    log = log or _with_points(path, sensor or "field", layout)
    points, is_raw = log.points, False
    if sensor is None and "field" not in log.streams:
        raw = read_phone_log(path, recover=layout.recover)
        if "raw_field" in raw.streams:
            is_raw, sensor = True, "raw_field"
        log = raw
    stream = log.require(sensor or "field", "a survey")
    if is_raw or (sensor is None and layout.field_unit == "uT"):
        _warn_of_an_offset(path, stream, is_raw=is_raw)
    field = layout.turned(stream.values / TESLA_PER_UNIT["uT"] * TESLA_PER_UNIT[layout.field_unit])
    return replace(with_poses(path, stream.times, field, layout, trajectory), waypoints=points)


def _warn_of_an_offset(path: str | Path, stream: Stream, *, is_raw: bool) -> None:
    """Warn of raw readings, which have an offset, and of a size unusual on Earth, which an offset explains."""
    measured = unusual_size(float(np.median(np.linalg.norm(stream.values, axis=1))))
    if is_raw:
        words = "%s: read without the phone's own calibration; expect an offset ('magmatch prepare')%s"
        logger.warning(words, path, f": {measured}" if measured else "")
    elif measured:
        logger.warning("%s: %s: a magnet, or an offset of the sensor ('magmatch prepare')?", path, measured)


def _with_points(path: str | Path, sensor: Sensor, layout: SurveyFormat) -> PhoneLog:
    """One sensor of a log with the walker's points; a fault of these alone is no fault of a survey."""
    try:
        return read_phone_log(path, (sensor,), recover=layout.recover, with_points=True)
    except DataFormatError as fault:
        log = read_phone_log(path, (sensor,), recover=layout.recover)
        logger.warning("%s (none of its surveyed points is read)", fault)
        return log
