# SPDX-License-Identifier: BSD-3-Clause
"""The metadata beside the readings: when phyphox was paused, and which way Sensor Logger's axes point."""

import logging
from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np

from magmatch.data.formats.phones.containers import member
from magmatch.data.formats.phones.phone_log import Sensor, Stream
from magmatch.data.tables.text import text_lines
from magmatch.errors import DataFormatError

logger = logging.getLogger(__name__)

# Where each app writes it.
ABOUT = {"phyphox": "meta/time.csv", "Sensor Logger": "Metadata.csv"}
FORCES: tuple[Sensor, ...] = ("acceleration", "linear_acceleration", "gravity")


def with_metadata(path: Path, app: str, streams: Mapping[Sensor, Stream]) -> Mapping[Sensor, Stream]:
    """Readings as the export's own metadata say that they are meant."""
    if app not in ABOUT or not streams or (raw := member(path, ABOUT[app])) is None:
        return streams
    try:
        rows = _rows(path / ABOUT[app], raw)
    except DataFormatError as error:
        logger.warning("%s; it is left aside", error)
        return streams
    return _without_pauses(path, rows, streams) if app == "phyphox" else _upright(rows, streams)


def _without_pauses(
    path: Path, rows: Sequence[Mapping[str, str]], streams: Mapping[Sensor, Stream]
) -> Mapping[Sensor, Stream]:
    """Times of phyphox go on across a pause as if there were none: what follows is moved by it."""
    try:
        pauses = _pauses(rows)
    except (KeyError, ValueError) as error:
        logger.warning("%s: its meta/time.csv cannot be read (%s), so pauses are not known", path, error)
        return streams
    if not pauses:
        return streams
    said = ", ".join(f"{length:.4g} s at {at:.4g} s" for at, length in pauses[:5]) + ", ..." * (len(pauses) > 5)
    if min(length for _, length in pauses) < 0:
        words = "%s: was paused (%s), while the phone's clock was set back; times go on as if there were no pause"
        logger.warning(words, path, said)
        return streams
    logger.warning("%s: was paused (%s); what follows a pause is moved by it (meta/time.csv)", path, said)
    starts = np.array([at for at, _ in pauses])
    behind = np.concatenate([[0.0], np.cumsum([length for _, length in pauses])])
    return {
        sensor: replace(stream, times=stream.times + behind[np.searchsorted(starts, stream.times, side="right")])
        for sensor, stream in streams.items()
    }


def _pauses(rows: Sequence[Mapping[str, str]]) -> list[tuple[float, float]]:
    """Pauses, each with its time on the clock without pauses, and its length by the phone's clock, both in s."""
    pauses, stopped = [], None
    for row in rows:
        event, *numbers = row["event"].upper(), row["experiment time"], row["system time"]
        if event not in {"START", "PAUSE"}:
            continue
        at, clock = (float(number.replace(",", ".")) for number in numbers)
        if not np.isfinite([at, clock]).all():
            msg = f"expected finite numbers, found {numbers}"
            raise ValueError(msg)
        if event == "START" and stopped is not None and clock != stopped:
            pauses.append((at, clock - stopped))
        stopped = clock if event == "PAUSE" else None
    return sorted(pauses)


def _upright(rows: Sequence[Mapping[str, str]], streams: Mapping[Sensor, Stream]) -> Mapping[Sensor, Stream]:
    """Accelerations of iPhones point the other way, unless Sensor Logger was told to standardise them."""
    about = rows[0] if rows else {}
    if about.get("platform", "").lower() != "ios" or about.get("standardisation", "").lower() == "true":
        return streams
    return {s: replace(one, values=-one.values) if s in FORCES else one for s, one in streams.items()}


def _rows(place: Path, raw: bytes) -> list[Mapping[str, str]]:
    """Rows of a small table by the names of their columns (lower case)."""
    lines = [line for line in text_lines(place, raw) if line.strip()]
    mark = next((mark for mark in "\t;," if lines and mark in lines[0]), ",")
    head, *rest = [[cell.strip().strip('"').strip() for cell in line.split(mark)] for line in lines] or [[]]
    return [dict(zip(map(str.lower, head), row, strict=False)) for row in rest]
