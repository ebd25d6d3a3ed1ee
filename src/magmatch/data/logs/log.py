# SPDX-License-Identifier: BSD-3-Clause
"""The protocol of recorder logs: topics with counts and spans, and the messages of some topics."""

from collections.abc import Collection, Iterable, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any, NamedTuple, Protocol


class Channel(NamedTuple):
    """Topic, type and encoding of some messages; the type is spelled as in ROS 1 (``std_msgs/Header``)."""

    topic: str
    type: str
    encoding: str

    @classmethod
    def named(cls, topic: str, kind: str, encoding: str) -> "Channel":
        """Channel from the names in a log, made fit to be shown."""
        kind = printable(kind).replace(".", "/").replace("::", "/").replace("/msg/dds_/", "/").replace("/msg/", "/")
        return cls(printable(topic), kind.rstrip("_"), printable(encoding))


Message = tuple[Channel, int, bytes]  # with the time at which it was logged, ns, and its payload


class Count(NamedTuple):
    """The number of messages, and when the first and the last were logged; zeros for none."""

    n: int = 0
    first_ns: int = 0
    last_ns: int = 0

    def plus(self, other: "Count") -> "Count":
        """Both together."""
        if not (self.n and other.n):
            return self if self.n else other
        return Count(self.n + other.n, min(self.first_ns, other.first_ns), max(self.last_ns, other.last_ns))


@dataclass(frozen=True, slots=True)
class Topic:
    """A topic of a log; `count` messages can be read, logged between `first_ns` and `last_ns`."""

    name: str
    type: str
    encoding: str
    count: int
    first_ns: int
    last_ns: int

    @property
    def channel(self) -> Channel:
        """The label of its messages."""
        return Channel(self.name, self.type, self.encoding)

    def facts(self) -> dict[str, Any]:
        """Name, type, count, rate and span, ready for JSON."""
        seconds = (self.last_ns - self.first_ns) / 1e9
        rate = (self.count - 1) / seconds if seconds > 0 else None
        span = [self.first_ns / 1e9, self.last_ns / 1e9] if self.count else None
        return {"name": self.name, "type": self.type, "encoding": self.encoding, "count": self.count, "rate": rate,
                "span": span}  # fmt: skip


class Log(Protocol):
    """A recorder log, open for reading."""

    path: Path

    def topics(self) -> list[Topic]:
        """All topics, by name."""

    def messages(self, topics: Collection[str]) -> Iterator[Message]:
        """Messages of some topics, in the order of the file."""

    def close(self) -> None:
        """Close the file."""


def printable(name: str) -> str:
    """A name that can be shown: on one line, and not endless."""
    return "".join(c if c.isprintable() else "?" for c in name[:200])


def topics_of(counts: Iterable[tuple[Channel, Count]]) -> list[Topic]:
    """Topics by name, from the counts of their channels."""
    total: dict[Channel, Count] = {}
    for channel, count in counts:
        total[channel] = total.get(channel, Count()).plus(count)
    return [Topic(*channel, *total[channel]) for channel in sorted(total)]
