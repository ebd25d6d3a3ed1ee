# SPDX-License-Identifier: BSD-3-Clause
"""Messages of ROS 1, CDR and JSON as objects with the fields that their definitions name."""

import json
from functools import cache
from types import SimpleNamespace
from typing import TYPE_CHECKING, Any

from magmatch.data.logs.log import Channel
from magmatch.data.tables.text import printable

if TYPE_CHECKING:
    from rosbags.typesys.store import Typestore

ENCODINGS = ("ros1", "cdr", "json")
_TF = "tf2_msgs/msg/TFMessage"
_BATTERY, _OLD_BATTERY = "sensor_msgs/msg/BatteryState", "sensor_msgs/msg/OldBatteryState"
# ROS 1 had no temperatures in it before 2019.
_OLD_BATTERY_FIELDS = """std_msgs/Header header
float32 voltage
float32 current
float32[4] numbers
uint8[4] states
float32[] cell_voltage
string location
string serial_number"""


def decode(channel: Channel, payload: bytes) -> Any:
    """Decode a message of a channel; MalformedError says what is wrong with it."""
    if channel.encoding == "json":
        try:
            message = json.loads(payload, object_hook=lambda fields: JsonObject(**fields))
        except (ValueError, RecursionError) as error:
            raise no_json(error) from None
        if not isinstance(message, JsonObject):
            raise no_json(TypeError("no object"))
        return message
    kind = _TF if channel.type == "tf/tfMessage" else channel.type.replace("/", "/msg/")
    store = _definitions(channel.encoding)
    kinds = (_BATTERY, _OLD_BATTERY) if (kind, channel.encoding) == (_BATTERY, "ros1") else (kind,)
    fault: Exception | None = None
    for one in kinds:
        try:
            return (store.deserialize_ros1 if channel.encoding == "ros1" else store.deserialize_cdr)(payload, one)
        except Exception as error:  # libraries raise whatever they stumble over
            fault = fault or error
    words = printable(" ".join(str(fault).split()).rstrip("."))
    msg = f"is cut off or damaged, or of another message definition ({words})"
    raise MalformedError(msg)


class JsonObject(SimpleNamespace):
    """An object of a message written as JSON, with attributes for keys."""


class MalformedError(ValueError):
    """These bytes are no message of the expected type."""


def number(value: Any) -> float:
    """A number of a message; JSON has no NaN, and writes null."""
    return float("nan" if value is None else value)


def no_json(error: Exception) -> MalformedError:
    """Say what is wrong with a message written as JSON."""
    return MalformedError(printable(f"is not the JSON of such a message ({type(error).__name__}: {error})"))


@cache
def _definitions(encoding: str) -> "Typestore":
    """Message definitions of ROS 1 or, for CDR, ROS 2."""
    from rosbags.typesys import Stores, get_types_from_msg, get_typestore

    store = get_typestore(Stores.ROS1_NOETIC if encoding == "ros1" else Stores.ROS2_HUMBLE)
    if encoding == "ros1":
        store.register(get_types_from_msg("geometry_msgs/TransformStamped[] transforms", _TF))
        store.register(get_types_from_msg(_OLD_BATTERY_FIELDS, _OLD_BATTERY))
    return store
