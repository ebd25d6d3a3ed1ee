# SPDX-License-Identifier: BSD-3-Clause
"""Messages of ROS 1, CDR and JSON: decoded, and those of which a survey is made as stamps, frames and numbers."""

import json
from array import array
from collections.abc import Callable
from dataclasses import dataclass, field
from functools import cache, lru_cache
from types import SimpleNamespace
from typing import TYPE_CHECKING, Any

import numpy as np

from magmatch.data.logs.log import Channel
from magmatch.data.tables.text import printable
from magmatch.data.tables.times import SECOND
from magmatch.typing import Indices, Matrix

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

# Where in a message its position and orientation stand, or its vector.
PATHS = {
    "sensor_msgs/MagneticField": ("magnetic_field",),
    "geometry_msgs/Vector3Stamped": ("vector",),
    "geometry_msgs/PointStamped": ("point",),
    "geometry_msgs/PoseStamped": ("pose",),
    "geometry_msgs/PoseWithCovarianceStamped": ("pose", "pose"),
    "nav_msgs/Odometry": ("pose", "pose"),
    "geometry_msgs/TransformStamped": ("transform",),
    "tf2_msgs/TFMessage": ("transform",),
    "tf/tfMessage": ("transform",),
}
VECTORS = ("sensor_msgs/MagneticField", "geometry_msgs/Vector3Stamped", "geometry_msgs/PointStamped")
TREES = ("tf2_msgs/TFMessage", "tf/tfMessage")
WITH_CHILD = ("nav_msgs/Odometry", "geometry_msgs/TransformStamped", *TREES)
# Messages between which entries that are not needed are left out.
THINNED = 8192

Frames = tuple[str, str]  # of the header, and of the child ("" where the type has none)
Fault = tuple[int, str]  # number of a message, and what is wrong with it


class JsonObject(SimpleNamespace):
    """An object of a message written as JSON, with attributes for keys."""


class MalformedError(ValueError):
    """These bytes are no message of the expected type."""


def no_json(error: Exception) -> MalformedError:
    """Say what is wrong with a message written as JSON."""
    return MalformedError(printable(f"is not the JSON of such a message ({type(error).__name__}: {error})"))


def decode(channel: Channel, payload: bytes) -> Any:
    """Decode a message as an object with the fields of its definition; MalformedError says what is wrong with it."""
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
    read = store.deserialize_ros1 if channel.encoding == "ros1" else store.deserialize_cdr
    fault: Exception | None = None
    for one in (_BATTERY, _OLD_BATTERY) if (kind, channel.encoding) == (_BATTERY, "ros1") else (kind,):
        try:
            return read(payload, one)
        except Exception as error:  # libraries raise whatever they stumble over
            fault = fault or error
    words = printable(" ".join(str(fault).split()).rstrip("."))
    msg = f"is cut off or damaged, or of another message definition ({words})"
    raise MalformedError(msg)


@cache
def _definitions(encoding: str) -> "Typestore":
    """Message definitions of ROS 1 or, for CDR, ROS 2."""
    from rosbags.typesys import Stores, get_types_from_msg, get_typestore

    store = get_typestore(Stores.ROS1_NOETIC if encoding == "ros1" else Stores.ROS2_HUMBLE)
    if encoding == "ros1":
        store.register(get_types_from_msg("geometry_msgs/TransformStamped[] transforms", _TF))
        store.register(get_types_from_msg(_OLD_BATTERY_FIELDS, _OLD_BATTERY))
    return store


def number(value: Any) -> float:
    """A number of a message; JSON has no NaN, and writes null."""
    return float("nan" if value is None else value)


@dataclass(frozen=True, slots=True)
class Entries:
    """Decoded messages with the same frames."""

    frames: Frames
    number: Indices  # (n,): which message of the topic each comes from, counted from 0
    log_ns: Indices  # (n,): when it was logged, and the stamp in its header
    stamp_ns: Indices  # (n,)
    values: Matrix  # (n, 3) or (n, 7): as in the message; quaternions xyzw

    def at(self, rows: np.ndarray) -> "Entries":
        """Some of the entries, by index or mask."""
        return Entries(self.frames, self.number[rows], self.log_ns[rows], self.stamp_ns[rows], self.values[rows])


@dataclass(slots=True)
class Decoder:
    """Decodes the messages of one topic in the order of the file; `faults` are those that are none.

    Where not all entries are needed, `thin` leaves few of those of one edge, so that long logs fit in memory.
    """

    thin: Callable[[Entries], Entries] | None = None
    faults: list[Fault] = field(default_factory=list)
    # By frames: number, log time and stamp of each message; its values.
    _rows: "dict[Frames, tuple[array[int], array[float]]]" = field(default_factory=dict)
    _n: int = 0

    def take(self, channel: Channel, log_ns: int, payload: bytes) -> None:
        """Decode a message of a type in `PATHS`."""
        try:
            message = decode(channel, payload)
            for entry in message.transforms if channel.type in TREES else [message]:
                frames, stamp_ns, values = _numbers_of(entry, channel)
                row = array("q", (self._n, log_ns, stamp_ns))
                stamps, numbers = self._rows.setdefault(frames, (array("q"), array("d")))
                stamps.extend(row)
                numbers.extend(values)
        except MalformedError as error:
            self.faults.append((self._n, str(error)))
        except (ValueError, LookupError, TypeError, AttributeError, OverflowError) as error:
            self.faults.append((self._n, str(no_json(error))))
        self._n += 1
        if self.thin is not None and self._n % THINNED == 0:
            for frames, part in self.entries().items():
                few = self.thin(part)
                times = np.column_stack([few.number, few.log_ns, few.stamp_ns])
                self._rows[frames] = array("q", times.ravel().tolist()), array("d", few.values.ravel().tolist())

    def entries(self) -> dict[Frames, Entries]:
        """All that was decoded, by frames; entries in the order of the file."""
        found = {}
        for frames, (stamps, numbers) in self._rows.items():
            number, log_ns, stamp_ns = np.array(stamps, dtype=np.int64).reshape(-1, 3).T
            found[frames] = Entries(frames, number, log_ns, stamp_ns, np.array(numbers).reshape(len(number), -1))
        return found


def _numbers_of(entry: Any, channel: Channel) -> tuple[Frames, int, list[float]]:
    """Frames, stamp and values of a message."""
    header, part = entry.header, entry
    for key in PATHS[channel.type]:
        part = getattr(part, key)
    if channel.type in VECTORS:
        values = [number(v) for v in (part.x, part.y, part.z)]
    else:
        place = part.translation if hasattr(part, "translation") else part.position
        turn = part.rotation if hasattr(part, "rotation") else part.orientation
        values = [number(v) for v in (place.x, place.y, place.z, turn.x, turn.y, turn.z, turn.w)]
    stamp = vars(header.stamp)
    names = ("sec", "secs"), ("nanosec", "nsec", "nsecs")
    seconds, rest = (int(stamp[next((one for one in some if one in stamp), some[0])]) for some in names)
    if channel.encoding == "ros1":
        seconds %= 1 << 32  # ROS 1 counts seconds without a sign
    child = entry.child_frame_id if channel.type in WITH_CHILD else ""
    return (_name(str(header.frame_id)), _name(str(child))), seconds * SECOND + rest, values


@lru_cache
def _name(raw: str) -> str:
    """Name of a frame, without the slash that tf once put in front."""
    return printable(raw).lstrip("/")
