# SPDX-License-Identifier: BSD-3-Clause
"""Logs made of chunks with an index behind each: what ROS 1 bags and MCAP have in common."""

from collections.abc import Collection, Iterator
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Protocol

from magmatch.data.logs.log import Batch, Batcher, Channel, Loss, Topic
from magmatch.data.logs.source import MAX_CHUNK, DamagedError, Source
from magmatch.errors import DataFormatError

Message = tuple[int, int, int, int]  # channel id, log time (ns), start and stop of its payload in the chunk


@dataclass(frozen=True, slots=True)
class Count:
    """Messages of one channel: how many, and the first and last log time, ns."""

    n: int
    first_ns: int
    last_ns: int

    def plus(self, other: "Count") -> "Count":
        """Both together."""
        return Count(self.n + other.n, min(self.first_ns, other.first_ns), max(self.last_ns, other.last_ns))


@dataclass(frozen=True, slots=True)
class Chunk:
    """Where a chunk stands in the file, and what its index says of it.

    Attributes
    ----------
    start, stop : int
        Bytes of the whole record.
    body : int
        Where its (compressed) messages begin.
    compression : str
    size : int
        Declared length once decompressed.
    crc : int
        Of the decompressed content; 0 where there is none.
    index : dict of int to Count
        By channel id; empty where no index follows the chunk.
    """

    start: int
    stop: int
    body: int
    compression: str
    size: int
    crc: int = 0
    index: dict[int, Count] = field(default_factory=dict)


@dataclass(frozen=True, slots=True)
class Index:
    """What one index record says of the chunk before it."""

    channel: int
    count: Count


@dataclass(frozen=True, slots=True)
class Definition:
    """What a channel id stands for."""

    id: int
    channel: Channel


@dataclass(frozen=True, slots=True)
class Loose:
    """Messages that stand outside any chunk, as one record of the file."""

    start: int
    stop: int
    body: int


Piece = Chunk | Index | Definition | Loose | None


class Container(Protocol):
    """The layout of one file format."""

    def begin(self, source: Source) -> int:
        """Check the beginning; gives the position of the first record."""

    def doubt(self, source: Source) -> str | None:
        """What shows at a glance that the file is not whole."""

    def piece(self, source: Source, position: int) -> tuple[Piece, int]:
        """Read the record at a position, and where the next one begins (the file's size after the last)."""

    def contents(self, body: bytes, start: int, wanted: Collection[int] | None) -> Iterator[Message | Definition]:
        """Messages of some channels (all by default) and definitions in a chunk; ValueError where it breaks off."""

    def verify(self, chunk: Chunk, body: bytes) -> None:
        """DamagedError where the content does not fit the checksum."""

    def resume(self, source: Source, position: int) -> int | None:
        """The next place from a position on where a record plausibly begins."""


class ChunkedLog:
    """A log of chunks, open for reading.

    Parameters
    ----------
    path : path
        The file.
    container : Container
        Its layout.
    recover : bool
        Pass over what is damaged and note it, instead of refusing.
    """

    def __init__(self, path: str | Path, container: Container, *, recover: bool = False) -> None:
        self.path = Path(path)
        self._container, self._recover = container, recover
        self._losses: dict[int, Loss] = {}
        self._channels: dict[int, Channel] = {}
        self._topics: list[Topic] | None = None
        self._source = Source(path)
        try:
            self._begin = self._checked_begin()
        except DataFormatError:
            self.close()
            raise

    def _checked_begin(self) -> int:
        """Where the first record begins, in a file that looks whole or may be damaged."""
        try:
            begin = self._container.begin(self._source)
            doubt = self._container.doubt(self._source)
        except DamagedError as error:
            raise self._refusal(error.words) from None
        if doubt and not self._recover:
            raise self._refusal(doubt)
        return begin

    def close(self) -> None:
        """Let go of the file."""
        self._source.__exit__(None, None, None)

    def losses(self) -> list[Loss]:
        """What was left out so far."""
        return [self._losses[start] for start in sorted(self._losses)]

    def topics(self) -> list[Topic]:
        """All topics, by name; chunks are opened only where no index says what they hold."""
        if self._topics is None:
            counts: dict[int, Count] = {}
            for part in self._parts():
                index = part.index if isinstance(part, Chunk) and part.index else self._counted(part)
                for key, count in index.items():
                    counts[key] = counts[key].plus(count) if key in counts else count
            if counts.keys() - self._channels.keys():
                self._define_from_chunks()
            for key in counts.keys() - self._channels.keys():
                words = f"{counts[key].n} messages of channel {key}, which is nowhere defined"
                self._lose(self._begin, self._begin, words)
            self._topics = self._summed(counts)
        return self._topics

    def messages(self, topics: Collection[str]) -> Iterator[Batch]:
        """Messages of some topics; chunks without any of them are skipped where an index says so."""
        self.topics()
        wanted = {key for key, channel in self._channels.items() if channel.topic in topics}
        batcher = Batcher()
        for part in self._parts():
            if isinstance(part, Chunk) and part.index and not wanted & part.index.keys():
                continue
            body = self._body(part)
            for key, log_ns, start, stop in self._messages_in(part, body, wanted):
                batch = batcher.add(key, self._channels[key], log_ns, body[start:stop])
                if batch is not None:
                    yield batch
        yield from batcher.rest()

    def _parts(self) -> Iterator[Chunk | Loose]:
        """Chunks with their indexes, and loose messages, in the order of the file."""
        chunk: Chunk | None = None
        position = self._begin
        while position < self._source.size:
            start = position
            try:
                piece, position = self._container.piece(self._source, start)
            except DamagedError as error:
                following = self._container.resume(self._source, start + 1) if self._recover else None
                position = self._source.size if following is None else following
                self._lose(start, position, error.words)
                if chunk is not None:  # what follows the damage is no index of the chunk before it
                    yield chunk
                chunk = None
                continue
            if isinstance(piece, Index) and chunk is not None:
                chunk.index[piece.channel] = piece.count
            elif isinstance(piece, Definition):
                self._channels[piece.id] = piece.channel
            elif isinstance(piece, Chunk | Loose):
                if chunk is not None:
                    yield chunk
                chunk = piece if isinstance(piece, Chunk) else None
                if isinstance(piece, Loose):
                    yield piece
        if chunk is not None:
            yield chunk

    def _body(self, part: Chunk | Loose) -> bytes:
        """Decompressed content; empty where it is damaged and that is passed over."""
        if isinstance(part, Loose):
            return self._source.read(part.body, part.stop - part.body)
        is_cut = part.stop > self._source.size
        if part.stop - part.body > MAX_CHUNK:
            words = f"a chunk of {part.stop - part.body} bytes, more than the {MAX_CHUNK} allowed"
            self._lose(part.start, min(part.stop, self._source.size), words)
            return b""
        raw = self._source.read_available(part.body, part.stop - part.body)
        if is_cut and not self._recover:
            self._lose(part.start, self._source.size, "the file ends in the middle of a chunk")
        try:
            body = self._source.expand(part.start, part.compression, raw, part.size, is_cut=is_cut)
            if not is_cut:
                self._container.verify(part, body)
        except DamagedError as error:
            self._lose(part.start, min(part.stop, self._source.size), error.words)
            return b""
        if is_cut:
            words = f"the file ends within a chunk, of which {len(body)} of {part.size} bytes are left and read"
            self._lose(self._source.size, self._source.size, words)
        return body

    def _messages_in(self, part: Chunk | Loose, body: bytes, wanted: Collection[int] | None) -> Iterator[Message]:
        """Messages of a part, up to where it breaks off; definitions are taken on the way."""
        try:
            for item in self._container.contents(body, 0, wanted):
                if isinstance(item, Definition):
                    self._channels[item.id] = item.channel
                else:
                    yield item
        except ValueError as error:
            if part.stop <= self._source.size:  # else the cut itself has been noted
                self._lose(part.start, part.stop, str(error))

    def _counted(self, part: Chunk | Loose) -> dict[int, Count]:
        """Count messages one by one."""
        times: dict[int, list[int]] = {}
        for key, log_ns, _, _ in self._messages_in(part, self._body(part), None):
            times.setdefault(key, []).append(log_ns)
        return {key: Count(len(found), min(found), max(found)) for key, found in times.items()}

    def _define_from_chunks(self) -> None:
        """Definitions from inside the chunks, where the file has lost its summary."""
        for part in self._parts():
            for _ in self._messages_in(part, self._body(part), ()):
                pass

    def _summed(self, counts: dict[int, Count]) -> list[Topic]:
        """Counts by channel as topics."""
        topics: dict[Channel, Topic] = {}
        for key, channel in self._channels.items():
            count = counts.get(key)
            known = topics.get(channel)
            if count is None:
                topics.setdefault(channel, Topic(channel.topic, channel.type, channel.encoding, 0, 0, 0))
                continue
            both = count if known is None or not known.count else count.plus(_count_of(known))
            topics[channel] = Topic(
                channel.topic, channel.type, channel.encoding, both.n, both.first_ns, both.last_ns
            )
        return sorted(topics.values(), key=lambda topic: (topic.name, topic.type))

    def _lose(self, start: int, stop: int, words: str) -> None:
        """Refuse the damage, or note it once."""
        if not self._recover:
            refusal = f"damaged at byte {start}: {words}"
            raise self._refusal(refusal)
        known = self._losses.get(start)
        self._losses[start] = (
            Loss(start, stop, words) if known is None else replace(known, stop=max(known.stop, stop))
        )

    def _refusal(self, words: str) -> DataFormatError:
        return DataFormatError(self.path, f"{words}; --recover reads all that is whole of it")


def _count_of(topic: Topic) -> Count:
    return Count(topic.count, topic.first_ns, topic.last_ns)
