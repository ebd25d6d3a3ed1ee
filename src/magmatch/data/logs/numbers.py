# SPDX-License-Identifier: BSD-3-Clause
"""Plain numbers in a log, such as a battery's current or a joint's effort: what a disturbance may follow."""

import json
import logging
from collections.abc import Iterator, Sequence

import numpy as np

from magmatch.data.formats.channels import MAX_CHANNELS, Channel, Channels
from magmatch.data.logs.cursor import Cursor, MalformedError, UnevenError
from magmatch.data.logs.log import Batch, Log, Topic, printable
from magmatch.data.logs.log import Channel as Publisher
from magmatch.data.logs.messages import ENCODINGS
from magmatch.data.tables.nanoseconds import seconds_of
from magmatch.typing import Indices, Scalars

logger = logging.getLogger(__name__)

SCALARS = {
    "std_msgs/Float64": "f8", "std_msgs/Float32": "f4", "std_msgs/Int64": "i8", "std_msgs/Int32": "i4",
    "std_msgs/Int16": "i2", "std_msgs/Int8": "i1", "std_msgs/UInt64": "u8", "std_msgs/UInt32": "u4",
    "std_msgs/UInt16": "u2", "std_msgs/UInt8": "u1",
}  # fmt: skip
ARRAYS = {"std_msgs/Float64MultiArray": "f8", "std_msgs/Float32MultiArray": "f4"}
BATTERY, JOINTS = "sensor_msgs/BatteryState", "sensor_msgs/JointState"
TYPES = (*SCALARS, *ARRAYS, BATTERY, JOINTS)
# Elements of one message that become channels; longer ones are images, spectra or maps.
MAX_ELEMENTS = 32

# By the name of the number within its message: which rows have it, and its values there.
Numbers = dict[str, tuple[Indices, Scalars]]


def read_numbers(log: Log, topics: Sequence[Topic], delay_ns: float) -> Channels:
    """Read all topics of plain numbers.

    Parameters
    ----------
    log : Log
        Open.
    topics : sequence of Topic
        What it holds.
    delay_ns : float
        How much later messages were logged than the survey's clock says: these have no stamps, or other ones.

    Returns
    -------
    Channels
        On the survey's clock, under the name of the topic and that of the number where a message holds several.
        What is no such message is counted and left out.
    """
    wanted = {topic.name for topic in topics if topic.type in TYPES and topic.encoding in ENCODINGS and topic.count}
    parts: dict[str, list[tuple[Indices, Scalars]]] = {}
    n_bad = 0
    for batch in log.messages(wanted) if wanted else ():
        if batch.channel.type not in TYPES or batch.channel.encoding not in ENCODINGS:
            continue
        log_ns = np.array(batch.log_ns, dtype=np.int64)
        for numbers, n in decoded(batch):
            n_bad += n
            for name, (rows, values) in numbers.items():
                parts.setdefault(f"{batch.channel.topic} {name}".rstrip(), []).append((log_ns[rows], values))
    if n_bad:
        logger.warning("%s: left out %d messages of other channels that are not whole", log.path, n_bad)
    names = sorted(parts)[:MAX_CHANNELS]
    if len(parts) > len(names):
        logger.warning("%s: holds %d other channels, of which %d are looked at", log.path, len(parts), len(names))
    joined = {name: _joined(parts[name], delay_ns) for name in names}
    return Channels({name: channel for name, channel in joined.items() if len(channel.values)})


def _joined(parts: Sequence[tuple[Indices, Scalars]], delay_ns: float) -> Channel:
    """One channel in the order of time, without what is no number."""
    log_ns = np.concatenate([part[0] for part in parts]) - round(delay_ns)
    values = np.concatenate([part[1] for part in parts])
    order = np.argsort(log_ns, kind="stable")
    order = order[np.isfinite(values[order])]
    return Channel(seconds_of(log_ns[order].tolist()), values[order])


def decoded(batch: Batch) -> Iterator[tuple[Numbers, int]]:
    """Numbers of a batch.

    Parameters
    ----------
    batch : Batch
        Of a type in `TYPES` and an encoding that is read.

    Yields
    ------
    numbers : dict of str to (rows, values)
        By their names within a message.
    n_bad : int
        Messages that hold none.
    """
    if batch.channel.encoding == "json":
        for i, payload in enumerate(batch.payloads):
            yield _of_json(payload, batch.channel, i)
        return
    lengths = np.array([len(payload) for payload in batch.payloads])
    for length in np.unique(lengths).tolist():
        which = np.flatnonzero(lengths == length)
        rows = np.frombuffer(b"".join([batch.payloads[i] for i in which]), np.uint8).reshape(len(which), length)
        waiting = [np.arange(len(which))]
        while waiting:
            picked = waiting.pop()
            try:
                found = _read(rows[picked], batch.channel)
            except UnevenError as uneven:
                waiting += [picked[uneven.values == value] for value in np.unique(uneven.values)]
            except MalformedError:
                yield {}, len(picked)
            else:
                yield {name: (which[picked[at]], values) for name, (at, values) in found.items()}, 0


def _read(rows: np.ndarray, publisher: Publisher) -> Numbers:
    """Numbers of messages of one length, whose layouts may still differ."""
    if publisher.type == BATTERY:
        try:
            return _battery(Cursor(rows, publisher.encoding), has_temperature=True)
        except MalformedError:  # ROS 1 had another definition before 2019
            return _battery(Cursor(rows, publisher.encoding), has_temperature=False)
    cursor = Cursor(rows, publisher.encoding)
    if publisher.type == JOINTS:
        return _joints(cursor)
    if publisher.type in ARRAYS:
        return _array(cursor, ARRAYS[publisher.type])
    values = cursor.numbers(SCALARS[publisher.type], 1)[:, 0].astype(np.float64)
    _require_end(cursor)
    return {"": (np.arange(len(values)), values)}


def _battery(cursor: Cursor, *, has_temperature: bool) -> Numbers:
    """Current of a ``sensor_msgs/BatteryState``."""
    _skip_header(cursor)
    numbers = cursor.numbers("f4", 7 if has_temperature else 6).astype(np.float64)
    cursor.numbers("u1", 4)
    for _ in range(2 if has_temperature else 1):  # of each cell: voltage, temperature
        cursor.numbers("f4", cursor.count())
    cursor.text(), cursor.text()
    _require_end(cursor)
    return {"current": (np.arange(len(numbers)), numbers[:, 2 if has_temperature else 1])}


def _joints(cursor: Cursor) -> Numbers:
    """Efforts of a ``sensor_msgs/JointState``, by the joints' names."""
    _skip_header(cursor)
    names = [cursor.text() for _ in range(_few(cursor))]
    efforts = [cursor.numbers("f8", _few(cursor)).astype(np.float64) for _ in range(3)][2]  # position, velocity
    _require_end(cursor)
    found: dict[str, list[tuple[Indices, Scalars]]] = {}
    for column, values in zip(names, efforts.T, strict=False):  # either may be left empty
        for name in np.unique(column):
            at = np.flatnonzero(column == name)
            label = printable(name.rstrip(b"\0").decode("utf-8", "replace"))
            found.setdefault(f"effort {label}", []).append((at, values[at]))
    return {k: (np.concatenate([p[0] for p in v]), np.concatenate([p[1] for p in v])) for k, v in found.items()}


def _array(cursor: Cursor, kind: str) -> Numbers:
    """Elements of a ``std_msgs/...MultiArray``."""
    for _ in range(_few(cursor)):  # dimensions: name, size, stride
        cursor.text()
        cursor.numbers("u4", 2)
    cursor.numbers("u4", 1)
    values = cursor.numbers(kind, _few(cursor)).astype(np.float64)
    _require_end(cursor)
    return {f"[{k}]": (np.arange(len(values)), column) for k, column in enumerate(values.T)}


def _skip_header(cursor: Cursor) -> None:
    cursor.numbers("u4", 3 if cursor.encoding == "ros1" else 2)
    cursor.text()


def _few(cursor: Cursor) -> int:
    n = cursor.count()
    if n > MAX_ELEMENTS:
        msg = f"{n} elements"
        raise MalformedError(msg)
    return n


def _require_end(cursor: Cursor) -> None:
    """Another definition leaves bytes over; some writers pad to four."""
    if cursor.rest > (3 if cursor.encoding == "cdr" else 0):
        msg = f"{cursor.rest} bytes are left over"
        raise MalformedError(msg)


def _of_json(payload: bytes, publisher: Publisher, row: int) -> tuple[Numbers, int]:
    """Numbers of one message written as JSON."""
    try:
        content = json.loads(payload)
        if publisher.type == BATTERY:
            found = {"current": content["current"]}
        elif publisher.type == JOINTS:
            joints = list(zip(content["name"], content["effort"], strict=False))[:MAX_ELEMENTS]
            found = {f"effort {printable(str(name))}": effort for name, effort in joints}
        elif publisher.type in ARRAYS:
            found = {f"[{k}]": value for k, value in enumerate(content["data"][:MAX_ELEMENTS])}
        else:
            found = {"": content["data"]}
        return {k: (np.array([row]), np.array([v], dtype=np.float64)) for k, v in found.items() if v is not None}, 0
    except (ValueError, KeyError, TypeError, AttributeError, RecursionError, OverflowError):
        return {}, 1
