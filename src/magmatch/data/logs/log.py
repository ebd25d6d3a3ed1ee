# SPDX-License-Identifier: BSD-3-Clause
"""What every recorder log offers: topics with counts and spans, messages of some topics, and what was lost."""

from collections.abc import Collection, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Protocol

# Messages handed on at a time, of one channel, and their bytes: enough for array arithmetic, little to hold.
BATCH, BATCH_BYTES = 8192, 8 << 20


@dataclass(frozen=True, slots=True)
class Channel:
    """Messages of one topic, type and encoding, as one publisher sent them.

    Attributes
    ----------
    topic : str
    type : str
        Such as ``sensor_msgs/MagneticField``, spelled the same for ROS 1 and ROS 2.
    encoding : str
        ``ros1``, ``cdr``, ``json``, or one that is not read here.
    """

    topic: str
    type: str
    encoding: str

    @classmethod
    def named(cls, topic: str, kind: str, encoding: str) -> "Channel":
        """Channel as a log names it; what could not be shown in a message is replaced."""
        return cls(printable(topic), plain_type(printable(kind)), printable(encoding))


@dataclass(frozen=True, slots=True)
class Topic:
    """A topic of a log.

    Attributes
    ----------
    name, type, encoding : str
        As in `Channel`.
    count : int
        Messages that can be read.
    first_ns, last_ns : int
        When the first and the last of them were logged; 0 where there is none.
    """

    name: str
    type: str
    encoding: str
    count: int
    first_ns: int
    last_ns: int

    @property
    def duration(self) -> float:
        """Seconds between the first and the last message."""
        return (self.last_ns - self.first_ns) / 1e9

    def facts(self) -> dict[str, Any]:
        """Name, type, count, rate and span, ready for JSON."""
        rate = (self.count - 1) / self.duration if self.duration > 0 else None
        span = [self.first_ns / 1e9, self.last_ns / 1e9] if self.count else None
        return {"name": self.name, "type": self.type, "encoding": self.encoding, "count": self.count, "rate": rate,
                "span": span}  # fmt: skip


@dataclass(frozen=True, slots=True)
class Batch:
    """Some messages of one channel, in the order of the file.

    Attributes
    ----------
    channel : Channel
    log_ns : list of int
        When each was logged.
    payloads : list of bytes
    """

    channel: Channel
    log_ns: list[int]
    payloads: list[bytes]


@dataclass(frozen=True, slots=True)
class Loss:
    """A piece of a damaged log that was left out.

    Attributes
    ----------
    start, stop : int
        Bytes of the file; both 0 where the file does not keep messages in order (SQLite).
    words : str
        What was wrong with it.
    """

    start: int
    stop: int
    words: str

    @property
    def text(self) -> str:
        """Where and what, in words."""
        if self.stop > self.start:
            return f"bytes {self.start} to {self.stop}: {self.words}"
        return f"at byte {self.start}: {self.words}" if self.stop else self.words


class Log(Protocol):
    """A recorder log, open for reading."""

    path: Path

    def topics(self) -> list[Topic]:
        """All topics, by name."""

    def messages(self, topics: Collection[str]) -> Iterator[Batch]:
        """Messages of some topics, batch by batch; others are skipped without being looked at."""

    def losses(self) -> list[Loss]:
        """What was left out so far; empty unless damage may be passed over."""

    def close(self) -> None:
        """Let go of the file."""


def printable(name: str) -> str:
    """Names of a log as they can be shown: on one line and not endless."""
    return "".join(c if c.isprintable() else "?" for c in name[:200])


def plain_type(name: str) -> str:
    """Message type as ROS 1 spells it.

    Examples
    --------
    >>> plain_type("sensor_msgs/msg/MagneticField"), plain_type("sensor_msgs.MagneticField")
    ('sensor_msgs/MagneticField', 'sensor_msgs/MagneticField')
    """
    return name.replace(".", "/").replace("::", "/").replace("/msg/dds_/", "/").replace("/msg/", "/").rstrip("_")


class Batcher:
    """Collects messages by channel and hands on full batches."""

    def __init__(self) -> None:
        self._open: dict[int, Batch] = {}
        self._n_bytes: dict[int, int] = {}

    def add(self, key: int, channel: Channel, log_ns: int, payload: bytes) -> Batch | None:
        """Take one message of the channel with this number; gives a batch when one is full."""
        batch = self._open.get(key)
        if batch is None:
            batch = self._open[key] = Batch(channel, [], [])
            self._n_bytes[key] = 0
        batch.log_ns.append(log_ns)
        payloads = batch.payloads
        payloads.append(payload)
        n_bytes = self._n_bytes[key] = self._n_bytes[key] + len(payload)
        return self._open.pop(key) if n_bytes >= BATCH_BYTES or len(payloads) >= BATCH else None

    def rest(self) -> Iterator[Batch]:
        """Whatever has not been handed on."""
        while self._open:
            yield self._open.pop(next(iter(self._open)))
