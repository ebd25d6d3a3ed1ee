# SPDX-License-Identifier: BSD-3-Clause
"""Plain numbers in a log, such as a battery's current or a joint's effort: what a disturbance may follow."""

import logging
from collections.abc import Iterator, Sequence
from typing import Any

import numpy as np

from magmatch.data.formats.channels import MAX_CHANNELS, Channels, TimeSeries
from magmatch.data.logs.decode import ENCODINGS, decode
from magmatch.data.logs.log import Log, Topic, batches, printable
from magmatch.data.tables.nanoseconds import seconds_of
from magmatch.typing import Indices, Scalars

logger = logging.getLogger(__name__)

SIZES = ("Float64", "Float32", "Int64", "Int32", "Int16", "Int8", "UInt64", "UInt32", "UInt16", "UInt8")
ARRAYS = ("std_msgs/Float64MultiArray", "std_msgs/Float32MultiArray")
BATTERY, JOINTS = "sensor_msgs/BatteryState", "sensor_msgs/JointState"
TYPES = (*(f"std_msgs/{size}" for size in SIZES), *ARRAYS, BATTERY, JOINTS)
# Elements of one message that become channels; longer ones are images, spectra or maps.
MAX_ELEMENTS = 32


def read_numbers(log: Log, topics: Sequence[Topic], delay_ns: float) -> Channels:
    """Read all topics of plain numbers.

    Messages are placed by their log times less `delay_ns`, by which the field's messages were logged later than their
    stamps say. Channels are named after their topic, and the number where a message holds several. A message of
    another definition is counted and left out.
    """
    wanted = {
        topic.channel for topic in topics if topic.type in TYPES and topic.encoding in ENCODINGS and topic.count
    }
    parts: dict[str, list[tuple[Indices, Scalars]]] = {}
    n_bad = 0
    for channel, times, payloads in batches(log.messages({c.topic for c in wanted})) if wanted else ():
        if channel not in wanted:
            continue
        log_ns = np.array(times, dtype=np.int64)
        for rows, content in decode(channel, payloads):
            try:
                found = list(_named(channel.type, content, len(rows)))
            except (ValueError, LookupError, TypeError, AttributeError, OverflowError):
                n_bad += len(rows)
                continue
            for name, at, values in found:
                parts.setdefault(f"{channel.topic} {name}".rstrip(), []).append((log_ns[rows[at]], values))
    if n_bad:
        logger.warning("%s: left out %d messages of other channels that are not whole", log.path, n_bad)
    names = sorted(parts)[:MAX_CHANNELS]
    if len(parts) > len(names):
        logger.warning("%s: holds %d other channels; read are the first %d", log.path, len(parts), len(names))
    joined = {name: _joined(parts[name], delay_ns) for name in names}
    return Channels({name: channel for name, channel in joined.items() if len(channel.values)})


def _joined(parts: Sequence[tuple[Indices, Scalars]], delay_ns: float) -> TimeSeries:
    """One channel in the order of time, without NaN and infinity."""
    log_ns = np.concatenate([part[0] for part in parts]) - round(delay_ns)
    values = np.concatenate([part[1] for part in parts])
    order = np.argsort(log_ns, kind="stable")
    order = order[np.isfinite(values[order])]
    return TimeSeries(seconds_of(log_ns[order].tolist()), values[order])


def _named(kind: str, content: dict[str, Any] | str, n: int) -> Iterator[tuple[str, Indices, Scalars]]:
    """Numbers of `n` messages: name, which messages have it, and its values there."""
    if isinstance(content, str):
        raise ValueError(content)  # noqa: TRY004
    whole = np.arange(n)
    if kind == BATTERY:
        yield "current", whole, _column(content["current"], n)
    elif kind == JOINTS:
        efforts = _few(content["effort"], n)
        for names, values in zip(_few(content["name"], n), efforts, strict=False):  # either may be left empty
            column = np.broadcast_to(np.asarray(names), (n,))
            for name in np.unique(column):
                at = np.flatnonzero(column == name)
                label = name.decode("utf-8", "replace") if isinstance(name, bytes) else str(name)
                yield f"effort {printable(label)}", at, _column(values, n)[at]
    elif kind in ARRAYS:
        for k, values in enumerate(_few(content["data"], n)):
            yield f"[{k}]", whole, _column(values, n)
    else:
        yield "", whole, _column(content["data"], n)


def _column(values: Any, n: int) -> Scalars:
    """A number of each message; NaN for none."""
    return np.broadcast_to(np.asarray(values, dtype=np.float64), (n,))


def _few(elements: Any, n: int) -> Any:
    """The elements of a sequence: columns, or of JSON a list; ValueError where they are many."""
    columns = elements.T if isinstance(elements, np.ndarray) else elements
    if len(columns) > MAX_ELEMENTS:
        msg = f"{len(columns)} elements in each of {n} messages"
        raise ValueError(msg)
    return columns
