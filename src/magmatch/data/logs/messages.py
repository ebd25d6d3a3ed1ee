# SPDX-License-Identifier: BSD-3-Clause
"""Stamps, frames and numbers of the message types that a survey is made of."""

from array import array
from collections.abc import Callable
from dataclasses import dataclass, field
from functools import lru_cache
from typing import Any

import numpy as np

from magmatch.data.logs.decode import MalformedError, decode, no_json, number
from magmatch.data.logs.log import Channel
from magmatch.data.tables.text import printable
from magmatch.data.tables.times import SECOND
from magmatch.typing import Indices, Matrix

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


@dataclass(frozen=True, slots=True)
class Entries:
    """Decoded messages with the same frames."""

    frames: Frames  # (str, str): of the header, and of the child
    number: Indices  # (n,): which message of the topic each comes from, counted from 0
    log_ns: Indices  # (n,): when it was logged, and the stamp in its header
    stamp_ns: Indices  # (n,)
    values: Matrix  # (n, 3) or (n, 7): as in the message; quaternions xyzw

    def at(self, rows: np.ndarray) -> "Entries":
        """Some of the entries, by index or mask."""
        return Entries(self.frames, self.number[rows], self.log_ns[rows], self.stamp_ns[rows], self.values[rows])


class _Rows:
    """Numbers of the messages with the same frames, as they come."""

    def __init__(self, part: Entries | None = None) -> None:
        self.stamps, self.values = array("q"), array("d")  # number, log time and stamp of each message
        if part is not None:
            self.stamps.extend(np.column_stack([part.number, part.log_ns, part.stamp_ns]).ravel().tolist())
            self.values.extend(part.values.ravel().tolist())

    def entries(self, frames: Frames) -> Entries:
        """All of them so far."""
        number, log_ns, stamp_ns = np.array(self.stamps, dtype=np.int64).reshape(-1, 3).T
        return Entries(frames, number, log_ns, stamp_ns, np.array(self.values).reshape(len(number), -1))


@dataclass(slots=True)
class Decoder:
    """Decodes the messages of one topic in the order of the file; `faults` are those that are none.

    Where not all entries are needed, `thin` leaves few of those of one edge, so that long logs fit in memory.
    """

    thin: Callable[[Entries], Entries] | None = None
    faults: list[Fault] = field(default_factory=list)
    _rows: dict[Frames, _Rows] = field(default_factory=dict)
    _n: int = 0

    def take(self, channel: Channel, log_ns: int, payload: bytes) -> None:
        """Decode a message of a type in `PATHS`."""
        try:
            message = decode(channel, payload)
            for entry in message.transforms if channel.type in TREES else [message]:
                frames, stamp_ns, values = _numbers_of(entry, channel)
                stamps = array("q", (self._n, log_ns, stamp_ns))
                rows = self._rows.setdefault(frames, _Rows())
                rows.values.extend(values)
                rows.stamps.extend(stamps)
        except MalformedError as error:
            self.faults.append((self._n, str(error)))
        except (ValueError, LookupError, TypeError, AttributeError, OverflowError) as error:
            self.faults.append((self._n, str(no_json(error))))
        self._n += 1
        if self.thin is not None and self._n % THINNED == 0:
            self._rows = {frames: _Rows(self.thin(part)) for frames, part in self.entries().items()}

    def entries(self) -> dict[Frames, Entries]:
        """All that was decoded, by frames; entries in the order of the file."""
        return {frames: rows.entries(frames) for frames, rows in self._rows.items()}


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
