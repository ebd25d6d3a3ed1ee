# SPDX-License-Identifier: BSD-3-Clause
"""Many messages of one type as arrays, by the message definitions of rosbags.

Only the walk over them is ours: rosbags makes an object of each message, at 5 us each and more, which would more than
double the time to read a log (docs/decisions.md).
"""

import json
from collections.abc import Iterator, Sequence
from functools import cache
from typing import TYPE_CHECKING, Any, Literal

import numpy as np
from jaxtyping import UInt8

from magmatch.data.logs.log import Channel
from magmatch.typing import Indices

if TYPE_CHECKING:
    from rosbags.interfaces import Nodetype
    from rosbags.typesys.store import Typestore

ENCODINGS = ("ros1", "cdr", "json")
_TF = "tf2_msgs/msg/TFMessage"
# ROS 1 had no temperatures in it before 2019.
_OLD_BATTERY = """std_msgs/Header header
float32[6] numbers
uint8[4] states
float32[] cell_voltage
string location
string serial_number"""


class UnevenError(Exception):
    """Rows differ in something that decides where the next field stands; split them by its values."""

    def __init__(self, values: np.ndarray) -> None:
        super().__init__("rows differ in their layout")
        self.values = values


class MalformedError(Exception):
    """These bytes are no message of the expected type: the byte where they cease to be, and why."""

    def __init__(self, place: int, words: str) -> None:
        super().__init__(words)
        self.place = place


@cache
def definitions(encoding: str) -> "Typestore":
    """Message definitions of ROS 1 or, for CDR, ROS 2."""
    from rosbags.typesys import Stores, get_types_from_msg, get_typestore

    store = get_typestore(Stores.ROS1_NOETIC if encoding == "ros1" else Stores.ROS2_HUMBLE)
    if encoding == "ros1":
        store.register(get_types_from_msg("geometry_msgs/TransformStamped[] transforms", _TF))
        store.register(get_types_from_msg(_OLD_BATTERY, "sensor_msgs/msg/OldBatteryState"))
    return store


class Cursor:
    """A place in many messages of one length, read side by side.

    `encoding` is ``ros1`` (packed, little-endian) or ``cdr`` (aligned, byte order stated by four bytes in front).
    """

    def __init__(self, rows: UInt8[np.ndarray, "k n"], encoding: str) -> None:
        self._rows, self._is_cdr, self._store = rows, encoding == "cdr", definitions(encoding)
        self._at = self._origin = 0
        self._order: Literal["<", ">"] = "<"
        if self._is_cdr:
            kind = self.numbers("u1", 4)
            if (kind[:, 1] != kind[0, 1]).any():
                raise UnevenError(kind[:, 1])
            if kind[0, 0] or kind[0, 1] > 1:
                raise MalformedError(
                    self._at, f"expected plain CDR, found representation {kind[0, 0]:#04x} {kind[0, 1]:#04x}"
                )
            self._order = "<" if kind[0, 1] else ">"
            self._origin = 4

    def numbers(self, kind: str, n: int) -> np.ndarray:
        """Next numbers of each row, (k, n)."""
        dtype = np.dtype(kind).newbyteorder(self._order)
        if self._is_cdr and n:  # what is empty is not aligned
            self._at += -(self._at - self._origin) % dtype.itemsize
        return self._bytes(n * dtype.itemsize).view(dtype)

    def text(self) -> np.ndarray:
        """Next string of each row, as (k,) bytes."""
        n = self._count()
        return self._bytes(n).view(f"S{n}")[:, 0] if n else np.zeros(len(self._rows), "S1")

    def message(self, kind: str) -> dict[str, Any]:
        """Next message of each row, by the names of its fields."""
        return {name: self._field(*field) for name, field in self._store.fielddefs[kind][1]}

    def end(self) -> None:
        """MalformedError unless all has been read; some writers of CDR pad to four bytes."""
        rest = self._rows.shape[1] - self._at
        if rest > (3 if self._is_cdr else 0):
            raise MalformedError(self._at, f"{rest} bytes are left over: another message definition?")

    def _field(self, node: "Nodetype", detail: Any) -> Any:
        """A column, a table (k, n) of numbers, a list of these, or a nested message."""
        if node.name == "NAME":
            return self.message(detail)
        if node.name == "BASE":
            return self.text() if detail[0] == "string" else self.numbers(detail[0], 1)[:, 0]
        (inner, kind), n = detail
        n = n if node.name == "ARRAY" else self._count()
        if inner.name == "BASE" and kind[0] != "string":
            return self.numbers(kind[0], n)
        return [self._field(inner, kind) for _ in range(n)]

    def _count(self) -> int:
        """Next length, which decides what follows and so must be the same in all rows."""
        values = self.numbers("u4", 1)[:, 0]
        if (values != values[0]).any():
            raise UnevenError(values)
        return int(values[0])

    def _bytes(self, n: int) -> np.ndarray:
        rest = self._rows.shape[1] - self._at
        if n > rest:
            raise MalformedError(self._at, f"a field of {n} bytes where {max(rest, 0)} are left")
        self._at += n
        return np.ascontiguousarray(self._rows[:, self._at - n : self._at])


def decode(channel: Channel, payloads: Sequence[bytes]) -> Iterator[tuple[Indices, dict[str, Any] | str]]:
    """Decode messages of one channel: yields their rows, and their fields as columns or what is wrong with them.

    JSON messages come one at a time.
    """
    if channel.encoding == "json":
        for row, payload in enumerate(payloads):
            try:
                content = json.loads(payload)
            except (ValueError, RecursionError) as error:
                content = no_json(error)
            yield np.array([row]), content if isinstance(content, str | dict) else no_json(TypeError("no object"))
        return
    lengths = np.array([len(payload) for payload in payloads])
    for length in np.unique(lengths).tolist():
        which = np.flatnonzero(lengths == length)
        rows = np.frombuffer(b"".join([payloads[i] for i in which.tolist()]), np.uint8).reshape(len(which), length)
        waiting = [np.arange(len(which))]
        while waiting:
            picked = waiting.pop()
            try:
                yield which[picked], _decode_even(rows[picked], channel)
            except UnevenError as uneven:
                waiting += [picked[uneven.values == value] for value in np.unique(uneven.values)]
            except MalformedError as error:
                yield which[picked], str(error)


def no_json(error: Exception) -> str:
    """Say what is wrong with a message written as JSON."""
    return f"is not the JSON of such a message ({type(error).__name__}: {error})"


def _decode_even(rows: np.ndarray, channel: Channel) -> dict[str, Any]:
    """All fields of messages of one layout."""
    kind = _TF if channel.type == "tf/tfMessage" else channel.type.replace("/", "/msg/")
    try:
        return _decode_as(kind, rows, channel.encoding)
    except MalformedError:
        if (channel.type, channel.encoding) != ("sensor_msgs/BatteryState", "ros1"):
            raise
    old = _decode_as("sensor_msgs/msg/OldBatteryState", rows, "ros1")
    return {"current": old["numbers"][:, 1]}


def _decode_as(kind: str, rows: np.ndarray, encoding: str) -> dict[str, Any]:
    cursor = Cursor(rows, encoding)
    content = cursor.message(kind)
    cursor.end()
    return content
