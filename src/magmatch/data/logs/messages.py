# SPDX-License-Identifier: BSD-3-Clause
"""Messages as arrays: stamps, frames and numbers of the few types that a survey is made of."""

import json
from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any

import numpy as np

from magmatch.data.logs.cursor import Cursor, MalformedError, UnevenError
from magmatch.data.logs.log import Batch, printable
from magmatch.typing import Indices, Matrix

SECOND = 1_000_000_000


@dataclass(frozen=True, slots=True)
class Layout:
    """What stands behind the header of a message type.

    Attributes
    ----------
    n_values : int
        Numbers that are kept.
    n_rest : int
        Numbers behind them that are not.
    has_child : bool
        Whether the name of a second frame stands before the numbers.
    is_list : bool
        Whether a message holds any number of such entries.
    json_path : tuple of str
        Where the numbers stand in JSON.
    """

    n_values: int
    n_rest: int = 0
    has_child: bool = False
    is_list: bool = False
    json_path: tuple[str, ...] = ()


LAYOUTS = {
    "sensor_msgs/MagneticField": Layout(3, 9, json_path=("magnetic_field",)),
    "geometry_msgs/Vector3Stamped": Layout(3, json_path=("vector",)),
    "geometry_msgs/PointStamped": Layout(3, json_path=("point",)),
    "geometry_msgs/PoseStamped": Layout(7, json_path=("pose",)),
    "geometry_msgs/PoseWithCovarianceStamped": Layout(7, 36, json_path=("pose", "pose")),
    "nav_msgs/Odometry": Layout(7, 36 + 6 + 36, has_child=True, json_path=("pose", "pose")),
    "geometry_msgs/TransformStamped": Layout(7, has_child=True, json_path=("transform",)),
    "tf2_msgs/TFMessage": Layout(7, has_child=True, is_list=True, json_path=("transform",)),
    "tf/tfMessage": Layout(7, has_child=True, is_list=True, json_path=("transform",)),
}
ENCODINGS = ("ros1", "cdr", "json")

Frames = tuple[str, str]  # of the header, and of the child ("" where the type has none)


@dataclass(frozen=True, slots=True)
class Entries:
    """Decoded messages with the same frames.

    Attributes
    ----------
    frames : (str, str)
        Of the header, and of the child.
    number : (n,) int array
        Which message of the topic each comes from, counted from 0.
    log_ns, stamp_ns : (n,) int arrays
        When it was logged, and the stamp in its header.
    values : (n, 3) or (n, 7) array
        As in the message; quaternions xyzw.
    """

    frames: Frames
    number: Indices
    log_ns: Indices
    stamp_ns: Indices
    values: Matrix


@dataclass(frozen=True, slots=True)
class Faults:
    """Messages that are none, by number, with what is wrong with the first."""

    numbers: list[int]
    words: list[str]


class Decoder:
    """Decodes the messages of one topic, batch by batch in the order of the file.

    Attributes
    ----------
    faults : Faults
        What could not be decoded.
    """

    def __init__(self) -> None:
        self.faults = Faults([], [])
        self._parts: dict[Frames, list[Entries]] = {}
        self._n = 0

    def take(self, batch: Batch) -> None:
        """Decode messages of a type in `LAYOUTS` and an encoding in `ENCODINGS`."""
        for entries in _decode_batch(batch, self._n, self.faults):
            self._parts.setdefault(entries.frames, []).append(entries)
        self._n += len(batch.payloads)

    def entries(self) -> dict[Frames, Entries]:
        """All that was decoded, by frames; entries in the order of the file."""
        return {frames: _joined(frames, parts) for frames, parts in self._parts.items()}


def _joined(frames: Frames, parts: list[Entries]) -> Entries:
    number = np.concatenate([part.number for part in parts])
    order = np.argsort(number, kind="stable")
    return Entries(
        frames,
        number[order],
        np.concatenate([part.log_ns for part in parts])[order],
        np.concatenate([part.stamp_ns for part in parts])[order],
        np.concatenate([part.values for part in parts])[order],
    )


def _decode_batch(batch: Batch, first: int, faults: Faults) -> Iterator[Entries]:
    """Decode rows of equal length together."""
    layout, log_ns = LAYOUTS[batch.channel.type], np.array(batch.log_ns, dtype=np.int64)
    if batch.channel.encoding == "json":
        yield from _decode_json(batch, layout, first, faults)
        return
    lengths = np.array([len(payload) for payload in batch.payloads])
    for length in np.unique(lengths).tolist():
        which = np.flatnonzero(lengths == length)
        rows = np.frombuffer(b"".join([batch.payloads[i] for i in which]), np.uint8).reshape(len(which), length)
        for picked, stamped in _even(rows, batch.channel.encoding, layout, first + which, faults):
            for header, child, stamp_ns, values in stamped:
                for frames, here in _by_frames(header, child):
                    chosen = picked[here]
                    yield Entries(frames, first + which[chosen], log_ns[which[chosen]], stamp_ns[here], values[here])


Stamped = tuple[np.ndarray, np.ndarray, Indices, Matrix]  # header frame, child frame, stamp, values


def _even(
    rows: np.ndarray, encoding: str, layout: Layout, numbers: np.ndarray, faults: Faults
) -> Iterator[tuple[np.ndarray, list[Stamped]]]:
    """Decode rows, split wherever they differ in layout."""
    waiting = [np.arange(len(rows))]
    while waiting:
        picked = waiting.pop()
        try:
            yield picked, _read(Cursor(rows[picked], encoding), layout)
        except UnevenError as uneven:
            waiting += [picked[uneven.values == value] for value in np.unique(uneven.values)]
        except MalformedError as error:
            faults.numbers.extend(numbers[picked].tolist())
            faults.words.append(str(error))


def _read(cursor: Cursor, layout: Layout) -> list[Stamped]:
    """Read all fields of some messages."""
    n = cursor.count() if layout.is_list else 1
    entries = [_read_one(cursor, layout) for _ in range(n)]
    if cursor.rest > (3 if cursor.encoding == "cdr" else 0):  # some writers pad to four bytes
        msg = f"{cursor.rest} bytes are left over: another message definition?"
        raise MalformedError(msg)
    return entries


def _read_one(cursor: Cursor, layout: Layout) -> Stamped:
    if cursor.encoding == "ros1":
        cursor.numbers("u4", 1)  # sequence number
    seconds = cursor.numbers("u4" if cursor.encoding == "ros1" else "i4", 1)[:, 0].astype(np.int64)
    stamp_ns = seconds * SECOND + cursor.numbers("u4", 1)[:, 0]
    header = cursor.text()
    child = cursor.text() if layout.has_child else np.zeros(len(cursor), "S1")
    values = cursor.numbers("f8", layout.n_values).astype(np.float64)
    if layout.n_rest:
        cursor.numbers("f8", layout.n_rest)
    return header, child, stamp_ns, values


def _by_frames(header: np.ndarray, child: np.ndarray) -> Iterator[tuple[Frames, np.ndarray]]:
    """Rows by the frames they name."""
    same = (header == header[0]) & (child == child[0])
    if same.all():
        yield (_name(header[0]), _name(child[0])), np.arange(len(header))
        return
    pairs = np.array(list(zip(header.tolist(), child.tolist(), strict=True)), dtype=object)
    names = {tuple(pair) for pair in pairs.tolist()}
    for pair in sorted(names):
        yield (_name(pair[0]), _name(pair[1])), np.flatnonzero((header == pair[0]) & (child == pair[1]))


def _name(raw: bytes) -> str:
    """Name of a frame, without the slash that tf once put in front."""
    return printable(raw.rstrip(b"\0").decode("utf-8", "replace")).lstrip("/")


def _decode_json(batch: Batch, layout: Layout, first: int, faults: Faults) -> Iterator[Entries]:
    """Decode messages written as JSON, one by one."""
    for i, (log_ns, payload) in enumerate(zip(batch.log_ns, batch.payloads, strict=True)):
        try:
            content = json.loads(payload)
            for entry in content["transforms"] if layout.is_list else [content]:
                frames, stamp_ns, values = _read_json(entry, layout)
                one = np.array([[first + i], [log_ns], [stamp_ns]], dtype=np.int64)
                yield Entries(frames, one[0], one[1], one[2], values)
        except (ValueError, KeyError, TypeError, AttributeError, RecursionError, OverflowError) as error:
            faults.numbers.append(first + i)
            faults.words.append(
                printable(f"is not the JSON of such a message ({type(error).__name__}: {error}") + ")"
            )


def _read_json(entry: dict[str, Any], layout: Layout) -> tuple[Frames, int, Matrix]:
    header = entry["header"]
    stamp = header["stamp"]
    seconds = stamp["sec"] if "sec" in stamp else stamp["secs"]
    rest = next(stamp[name] for name in ("nanosec", "nsec", "nsecs") if name in stamp)
    part: Any = entry
    for key in layout.json_path:
        part = part[key]
    if layout.n_values == 7:
        place = part["translation"] if "translation" in part else part["position"]
        turn = part["rotation"] if "rotation" in part else part["orientation"]
        numbers = [place[k] for k in "xyz"] + [turn[k] for k in "xyzw"]
    else:
        numbers = [part[k] for k in "xyz"]
    header_frame = printable(str(header["frame_id"])).lstrip("/")
    child = printable(str(entry["child_frame_id"])).lstrip("/") if layout.has_child else ""
    values = np.array([[float(number) for number in numbers]])
    return (header_frame, child), int(seconds) * SECOND + int(rest), values
