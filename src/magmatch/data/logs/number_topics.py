# SPDX-License-Identifier: BSD-3-Clause
"""Plain numbers in a log, such as a battery's current or a joint's effort: what a disturbance may follow."""

import logging
from array import array
from collections.abc import Iterator, Sequence
from typing import Any

import numpy as np

from magmatch.data.formats.recording import MAX_CHANNELS, Channels, TimeSeries
from magmatch.data.logs.log import Log, Topic
from magmatch.data.logs.messages import ENCODINGS, decode, number
from magmatch.data.tables.text import printable
from magmatch.data.tables.times import seconds_of

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
    parts: dict[str, tuple[array[int], array[float]]] = {}
    n_bad = 0
    for channel, log_ns, payload in log.messages({c.topic for c in wanted}) if wanted else ():
        if channel not in wanted:
            continue
        try:
            found = [(name, number(value)) for name, value in _named(channel.type, decode(channel, payload))]
        except (ValueError, TypeError, AttributeError, OverflowError):
            n_bad += 1
            continue
        for name, value in found:
            times, values = parts.setdefault(f"{channel.topic} {name}".rstrip(), (array("q"), array("d")))
            times.append(log_ns)
            values.append(value)
    if n_bad:
        logger.warning("%s: left out %d messages of other channels that are not whole", log.path, n_bad)
    names = sorted(parts)[:MAX_CHANNELS]
    if len(parts) > len(names):
        logger.warning("%s: holds %d other channels; read are the first %d", log.path, len(parts), len(names))
    channels = {}
    for name in names:
        logged, numbers = (np.array(part) for part in parts[name])
        order = np.argsort(logged, kind="stable")
        order = order[np.isfinite(numbers[order])]
        if len(order):
            channels[name] = TimeSeries(seconds_of((logged[order] - round(delay_ns)).tolist()), numbers[order])
    return channels


def _named(kind: str, message: Any) -> Iterator[tuple[str, Any]]:
    """Numbers of a message, by name."""
    if kind == BATTERY:
        yield "current", message.current
    elif kind == JOINTS:
        joints = zip(_few(message.name), _few(message.effort), strict=False)  # either may be left empty
        yield from ((f"effort {printable(str(name))}", effort) for name, effort in joints)
    elif kind in ARRAYS:
        yield from ((f"[{k}]", element) for k, element in enumerate(_few(message.data)))
    else:
        yield "", message.data


def _few(elements: Sequence[Any]) -> Sequence[Any]:
    """The elements of a sequence; ValueError where they are many."""
    if len(elements) > MAX_ELEMENTS:
        msg = f"{len(elements)} elements in a message"
        raise ValueError(msg)
    return elements
