# SPDX-License-Identifier: BSD-3-Clause
"""Files of recorders, each read by a library: ROS 1 bags by rosbags, ROS 2 databases by SQLite, MCAP by mcap.

Messages come as they are stored: where the recorder's clock was set back, only that order tells. The readers of
rosbags for ROS 2 sort them by time, and pass over what SQLite still holds in a journal.
"""

import sqlite3
from collections.abc import Collection, Iterator
from functools import partial
from pathlib import Path
from typing import NamedTuple
from urllib.parse import quote

import mcap.records as mcap
from mcap.data_stream import ReadDataStream
from mcap.exceptions import EndOfFile, McapError
from mcap.reader import SeekingReader
from mcap.stream_reader import StreamReader, breakup_chunk
from rosbags.rosbag1 import Reader

from magmatch.data.logs.log import Channel, Count, Log, Message
from magmatch.data.tables.text import damage_told
from magmatch.errors import DataFormatError

MCAP_MAGIC = b"\x89MCAP0\r\n"
RECORD_HEAD = 9  # bytes of operation and length before the content of a record of MCAP


class _Place(NamedTuple):
    """An entry of a bag's index, sorted by its place in the file: no chunk is opened twice."""

    chunk_pos: int
    offset: int
    time: int


class Ros1Log(Log):
    """A ROS 1 bag, open for reading."""

    def __init__(self, path: Path) -> None:
        self.path, self._reader = path, Reader(path)
        self.close = self._reader.close
        self._damage_told = partial(damage_told, path, "ROS 1 bag", "; rosbag reindex mends it")
        with self._damage_told():
            self._reader.open()
        self.channels = {c.id: Channel.named(c.topic, c.msgtype, "ros1") for c in self._reader.connections}
        # Where the reader expects what it sorted by time.
        self._reader.indexes = {
            key: sorted(_Place(one.chunk_pos, one.offset, one.time) for one in index)  # type: ignore[misc]
            for key, index in self._reader.indexes.items()
        }
        times = {key: [one.time for one in index] for key, index in self._reader.indexes.items()}
        self.counts = {key: Count(len(found), min(found), max(found)) for key, found in times.items() if found}

    def messages(self, topics: Collection[str]) -> Iterator[Message]:
        """Messages of some topics, in the order of the file."""
        channels = self.channels_of(topics)
        wanted = [connection for connection in self._reader.connections if connection.id in channels]
        with self._damage_told():
            for connection, log_ns, payload in self._reader.messages(wanted) if wanted else ():
                yield channels[connection.id], log_ns, payload


class SqliteLog(Log):
    """The database of a ROS 2 bag, open for reading; nothing in it is trusted."""

    def __init__(self, path: Path) -> None:
        self.path = path
        advice = "; sqlite3 (.recover), and then ros2 bag reindex, mends it"
        self._damage_told = partial(damage_told, path, "ROS 2 bag", advice)
        # Where the recorder left a journal, SQLite has to look at it; else the file is not even locked.
        journal = path.with_name(path.name + "-wal")
        mode = "mode=ro" if journal.exists() and journal.stat().st_size else "mode=ro&immutable=1"
        with self._damage_told():
            self._database = sqlite3.connect(f"file:{quote(str(path.resolve()))}?{mode}", uri=True)
        self.close = self._database.close
        self._database.text_factory = lambda raw: raw.decode("utf-8", "replace")
        try:
            with self._damage_told():
                self.channels, self.counts = self._read_channels(), self._count()
        except DataFormatError:
            self.close()
            raise

    def _read_channels(self) -> dict[int, Channel]:
        """Topics by number; only true tables are asked, since a view could compute without end."""
        self._database.execute("PRAGMA trusted_schema = OFF")
        tables = {name for (name,) in self._database.execute("SELECT name FROM sqlite_master WHERE type = 'table'")}
        if missing := {"topics", "messages"} - tables:
            message = f"is a SQLite database without table {', '.join(sorted(missing))}: not a ROS 2 bag"
            raise DataFormatError(self.path, message)
        rows = self._database.execute("SELECT id, name, type, serialization_format FROM topics").fetchall()
        if not all(isinstance(key, int) and all(isinstance(text, str) for text in texts) for key, *texts in rows):
            raise DataFormatError(self.path, "its table of topics holds other things than names")
        return {key: Channel.named(*texts) for key, *texts in rows}

    def _count(self) -> dict[int, Count]:
        """Learn how many messages there are of each topic, and from when."""
        query = "SELECT topic_id, count(*), min(timestamp), max(timestamp) FROM messages GROUP BY topic_id"
        counts = {key: Count(*count) for key, *count in self._database.execute(query)}
        if not all(isinstance(number, int) for count in counts.values() for number in count):
            raise DataFormatError(self.path, "holds messages whose time stamp is no whole number")
        return counts

    def messages(self, topics: Collection[str]) -> Iterator[Message]:
        """Messages of some topics, in the order in which they were written."""
        wanted = self.channels_of(topics)
        marks = ",".join(map(str, wanted))
        query = f"SELECT topic_id, timestamp, data FROM messages WHERE topic_id IN ({marks}) ORDER BY id"
        with self._damage_told():
            for key, log_ns, payload in self._database.execute(query):
                if type(log_ns) is not int or type(payload) is not bytes:
                    raise DataFormatError(self.path, "holds a message without a whole number as time stamp, or data")
                yield wanted[key], log_ns, payload


class McapLog(Log):
    """An MCAP file, open for reading; chunks are passed over where a whole index says what they hold."""

    def __init__(self, path: Path) -> None:
        self.path, self._stream = path, path.open("rb")
        self.close = self._stream.close
        self._damage_told = partial(damage_told, path, "MCAP file", "; mcap recover mends it")
        self._schemas = {0: ""}
        self.channels, self.counts = {}, {}
        self._chunks: list[mcap.ChunkIndex] | None = None
        try:
            with self._damage_told():
                self._stream.seek(-len(MCAP_MAGIC), 2)
                if self._stream.read() != MCAP_MAGIC:
                    raise EndOfFile  # noqa: TRY301
                self._stream.seek(0)
                if not self._read_index():
                    self._count()
        except BaseException:
            self.close()
            raise

    def messages(self, topics: Collection[str]) -> Iterator[Message]:
        """Messages of some topics, in the order of the file."""
        wanted = self.channels_of(topics)
        left = {key: self.counts.get(key, Count()).n for key in wanted}
        with self._damage_told():
            for record in self._records(wanted):
                if isinstance(record, mcap.Message) and record.channel_id in wanted:
                    left[record.channel_id] -= 1
                    yield wanted[record.channel_id], _possible(record.log_time), record.data
            if any(left.values()):  # in a chunk without a checksum, a wrong length hides what follows
                msg = "its chunks hold other messages than its index names"
                raise McapError(msg)

    def _records(self, wanted: Collection[int]) -> Iterator[mcap.McapRecord]:
        """All records of the file, or those of the chunks that hold some channels."""
        if self._chunks is None:
            self._stream.seek(0)
            yield from StreamReader(self._stream, validate_crcs=True).records
        for chunk in self._chunks or ():
            if not chunk.message_index_offsets.keys().isdisjoint(wanted):
                self._stream.seek(chunk.chunk_start_offset + RECORD_HEAD)
                yield from breakup_chunk(mcap.Chunk.read(ReadDataStream(self._stream)), validate_crc=True)

    def _read_index(self) -> bool:
        """Learn from the indexes what the chunks hold; whether that is all there is."""
        summary = SeekingReader(self._stream).get_summary()
        if summary is None or summary.statistics is None:
            return False
        for record in (*summary.schemas.values(), *summary.channels.values()):
            self._define(record)
        chunks = sorted(summary.chunk_indexes, key=lambda chunk: chunk.chunk_start_offset)
        for place in (place for chunk in chunks for place in chunk.message_index_offsets.values()):
            self._stream.seek(place + RECORD_HEAD)
            index = mcap.MessageIndex.read(ReadDataStream(self._stream))
            times = [time for time, _ in index.records]
            if times:
                self._add(index.channel_id, Count(len(times), min(times), _possible(max(times))))
        is_whole = sum(count.n for count in self.counts.values()) == summary.statistics.message_count
        self._chunks = chunks if is_whole and self.counts.keys() <= self.channels.keys() else None
        return self._chunks is not None

    def _count(self) -> None:
        """Learn from all records what the file holds."""
        self.counts = {}
        for record in self._records(()):
            self._define(record)
            if isinstance(record, mcap.Message):
                if record.channel_id not in self.channels:
                    msg = f"a message of channel {record.channel_id}, which is nowhere defined"
                    raise McapError(msg)
                self._add(record.channel_id, Count(1, *2 * [_possible(record.log_time)]))

    def _define(self, record: mcap.McapRecord) -> None:
        """Take what is a schema or a channel."""
        if isinstance(record, mcap.Schema):
            self._schemas[record.id] = record.name
        elif isinstance(record, mcap.Channel):
            if record.schema_id not in self._schemas:
                msg = f"channel {record.id} of schema {record.schema_id}, which is nowhere defined"
                raise McapError(msg)
            kind = self._schemas[record.schema_id]
            self.channels[record.id] = Channel.named(record.topic, kind, record.message_encoding)

    def _add(self, key: int, count: Count) -> None:
        self.counts[key] = self.counts.get(key, Count()).plus(count)


def _possible(log_ns: int) -> int:
    """A time of logging that is one."""
    if log_ns >> 63:
        msg = f"a message of the year {1970 + log_ns // 31_556_952_000_000_000}"
        raise McapError(msg)
    return log_ns
