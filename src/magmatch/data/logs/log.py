# SPDX-License-Identifier: BSD-3-Clause
"""What recorder logs have in common: topics with counts and spans, and the messages of some topics."""

from abc import ABC, abstractmethod
from collections.abc import Callable, Collection, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any, NamedTuple

from magmatch.data.tables.text import printable


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


class Log(ABC):
    """A recorder log, open for reading."""

    path: Path
    channels: dict[int, Channel]  # by number
    counts: dict[int, Count]  # of the channels that have messages
    close: Callable[[], None]  # closes the file

    def topics(self) -> list[Topic]:
        """All topics, by name."""
        total: dict[Channel, Count] = {}
        for key, channel in self.channels.items():
            total[channel] = total.get(channel, Count()).plus(self.counts.get(key, Count()))
        return [Topic(*channel, *total[channel]) for channel in sorted(total)]

    def channels_of(self, topics: Collection[str]) -> dict[int, Channel]:
        """Channels of some topics, by number."""
        return {key: channel for key, channel in self.channels.items() if channel.topic in topics}

    @abstractmethod
    def messages(self, topics: Collection[str]) -> Iterator[Message]:
        """Messages of some topics, in the order in which they were written."""
