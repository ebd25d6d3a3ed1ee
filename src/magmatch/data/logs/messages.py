# SPDX-License-Identifier: BSD-3-Clause
"""Stamps, frames and numbers of the message types that a survey is made of."""

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from magmatch.data.logs.decode import decode, no_json
from magmatch.data.logs.log import Channel, printable
from magmatch.data.tables.nanoseconds import SECOND
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


@dataclass(slots=True)
class Decoder:
    """Decodes the messages of one topic in the order of the file; `faults` are those that are none.

    Where not all entries are needed, `thin` leaves few of those of one edge, so that long logs fit in memory.
    """

    thin: Callable[[Entries], Entries] | None = None
    faults: list[Fault] = field(default_factory=list)
    _parts: dict[Frames, list[Entries]] = field(default_factory=dict)
    _n: int = 0

    def take(self, channel: Channel, log_ns: Sequence[int], payloads: Sequence[bytes]) -> None:
        """Decode some messages of a type in `PATHS`."""
        times = np.array(log_ns, dtype=np.int64)
        for rows, content in decode(channel, payloads):
            number = self._n + rows
            try:
                if isinstance(content, str):
                    raise ValueError(content)  # noqa: TRY301, TRY004
                for entry in content["transforms"] if channel.type in TREES else [content]:
                    for frames, here, stamp_ns, values in _by_frames(entry, channel, len(rows)):
                        part = Entries(frames, number[here], times[rows[here]], stamp_ns[here], values[here])
                        self._parts.setdefault(frames, []).append(part)
            except (ValueError, LookupError, TypeError, AttributeError, OverflowError) as error:
                words = content if isinstance(content, str) else no_json(error)
                self.faults += [(int(n), printable(words)) for n in number]
        self._n += len(payloads)
        if self.thin is not None:
            self._parts = {frames: [self.thin(part)] for frames, part in self.entries().items()}

    def entries(self) -> dict[Frames, Entries]:
        """All that was decoded, by frames; entries in the order of the file."""
        return {frames: _joined(frames, parts) for frames, parts in self._parts.items()}


def _joined(frames: Frames, parts: list[Entries]) -> Entries:
    number, log_ns, stamp_ns, values = (
        np.concatenate([getattr(part, name) for part in parts]) for name in ("number", "log_ns", "stamp_ns", "values")
    )
    return Entries(frames, number, log_ns, stamp_ns, values).at(np.argsort(number, kind="stable"))


def _by_frames(
    entry: dict[str, Any], channel: Channel, n: int
) -> Iterator[tuple[Frames, np.ndarray, Indices, Matrix]]:
    """Frames, rows that name them, and stamps and values of all rows."""
    header, part = entry["header"], entry
    for key in PATHS[channel.type]:
        part = part[key]
    if channel.type not in VECTORS:
        place = part["translation"] if "translation" in part else part["position"]
        turn = part["rotation"] if "rotation" in part else part["orientation"]
        columns = [place[k] for k in "xyz"] + [turn[k] for k in "xyzw"]
    else:
        columns = [part[k] for k in "xyz"]
    values = np.column_stack([_column(column, np.float64, n) for column in columns])
    stamp = header["stamp"]
    seconds = _column(stamp["sec"] if "sec" in stamp else stamp["secs"], np.int64, n)
    rest = next(stamp[name] for name in ("nanosec", "nsec", "nsecs") if name in stamp)
    if channel.encoding == "ros1":
        seconds = seconds % (1 << 32)  # ROS 1 counts seconds without a sign
    stamp_ns = seconds * SECOND + _column(rest, np.int64, n)
    names = [header["frame_id"], entry["child_frame_id"] if channel.type in WITH_CHILD else b""]
    header_frame, child = (np.broadcast_to(np.asarray(name), (n,)) for name in names)
    if (header_frame == header_frame[0]).all() and (child == child[0]).all():
        yield (_name(header_frame[0]), _name(child[0])), np.arange(n), stamp_ns, values
        return
    for pair in sorted(set(zip(header_frame.tolist(), child.tolist(), strict=True))):
        here = np.flatnonzero((header_frame == pair[0]) & (child == pair[1]))
        yield (_name(pair[0]), _name(pair[1])), here, stamp_ns, values


def _column(values: Any, dtype: type, n: int) -> np.ndarray:
    """One number of each message; of JSON, which may hold anything, the number of a single one."""
    column = np.asarray(values).astype(dtype) if isinstance(values, np.ndarray) else np.array([dtype(values)])
    if column.shape != (n,):
        msg = f"expected a number, found {str(values)[:40]}"
        raise ValueError(msg)
    return column


def _name(raw: bytes | str) -> str:
    """Name of a frame, without the slash that tf once put in front."""
    return printable(raw.decode("utf-8", "replace") if isinstance(raw, bytes) else str(raw)).lstrip("/")
