# SPDX-License-Identifier: BSD-3-Clause
"""ROS 1 bags, read by rosbags.

Ours are bounds on what chunks and indexes may hold, and the index of a damaged bag: rosbags bounds neither, and reads
a bag by its index alone.
"""

import errno
import struct
from collections import defaultdict
from collections.abc import Collection, Iterator
from contextlib import contextmanager
from functools import partial
from io import BytesIO
from pathlib import Path
from typing import BinaryIO, NamedTuple

import numpy as np
from rosbags.interfaces import Connection
from rosbags.rosbag1.reader import (
    Chunk,
    Header,
    IndexData,
    Reader,
    ReaderError,
    RecordType,
    decompressors,
    read_bytes,
)
from rosbags.rosbag1.reader import read_uint32 as read_length

from magmatch.data.logs.bounds import MAX_CHUNK, DamagedError, Decompressor
from magmatch.data.logs.log import Channel, Count, Loss, Message, Topic, printable, topics_of
from magmatch.data.tables.nanoseconds import SECOND
from magmatch.errors import DataFormatError
from magmatch.typing import Indices

MAGIC = b"#ROSBAG V2.0\n"
MAX_HEADER = 64 << 10  # bytes of a record's header
_CHUNK_MARK = b"\x04\x00\x00\x00op=\x05"
_FAULTS = (ReaderError, DamagedError, AssertionError, LookupError, ValueError, struct.error, OverflowError, EOFError,
           MemoryError)  # fmt: skip


class Place(NamedTuple):
    """An index entry as rosbags takes it, but sorted by its place in the file: no chunk is opened twice."""

    chunk_pos: int
    offset: int
    time: int


class Index:
    """Places of the messages of one connection, chunk by chunk; as arrays, where rosbags holds 150 bytes for each."""

    def __init__(self) -> None:
        self._parts: dict[int, tuple[Indices, Indices]] = {}

    def __iter__(self) -> Iterator[Place]:
        for start, (offsets, times) in sorted(self._parts.items(), key=lambda part: part[0]):
            for offset, time in zip(offsets.tolist(), times.tolist(), strict=True):
                yield Place(start, offset, time)

    def add(self, start: int, rows: Indices) -> None:
        """Take the messages of a chunk: seconds, nanoseconds, and their offsets in it."""
        seconds, nanoseconds, offsets = rows[np.argsort(rows[:, 2], kind="stable")].astype(np.int64).T
        self._parts[start] = offsets, seconds * SECOND + nanoseconds

    def count(self) -> Count:
        """Number of messages, first and last time."""
        times = [part[1] for part in self._parts.values() if len(part[1])]
        if not times:
            return Count()
        return Count(sum(map(len, times)), min(int(t.min()) for t in times), max(int(t.max()) for t in times))


class BoundedReader(Reader):
    """The reader of rosbags, with bounds on chunks and indexes."""

    position = 0  # where it stopped reading

    def __init__(self, path: Path) -> None:
        super().__init__(path)
        self._decompressor = Decompressor(path)
        self._index_left = path.stat().st_size
        self.places: dict[int, Index] = defaultdict(Index)

    def close(self) -> None:
        """Close the file, and keep the place for messages."""
        self.position = self.bio.tell() if self.bio else self.position
        super().close()

    def read_chunk(self) -> Chunk:
        """Read the head of the chunk at the current position."""
        chunk = super().read_chunk()
        if chunk.datasize > MAX_CHUNK:
            msg = f"a chunk of {chunk.datasize} bytes, more than the {MAX_CHUNK} allowed"
            raise ReaderError(msg)
        name = next(name for name, function in decompressors.items() if function is chunk.decompressor)
        return chunk._replace(decompressor=partial(self._decompressor.expand, name))

    def read_index_data(self, pos: int, indexes: dict[int, list[IndexData]]) -> None:  # noqa: ARG002
        """Read what one index record says of the chunk before it."""
        assert self.bio
        header = Header.read(self.bio, RecordType.IDXDATA)
        n_bytes = read_length(self.bio)
        self._index_left -= n_bytes
        if self._index_left < 0 or n_bytes != 12 * header.get_uint32("count"):  # or a small file makes a large index
            msg = "the lengths of its indexes do not fit"
            raise ReaderError(msg)
        rows = np.frombuffer(read_bytes(self.bio, n_bytes), "<u4").reshape(-1, 3)
        self.places[header.get_uint32("conn")].add(pos, rows)


class Ros1Log:
    """A ROS 1 bag, open for reading; with `recover`, damaged pieces are left out and noted."""

    def __init__(self, path: str | Path, *, recover: bool = False) -> None:
        self.path = Path(path)
        self._losses: list[Loss] = []
        self._found: dict[int, Connection] = {}
        self._reader = BoundedReader(self.path)
        with self.path.open("rb") as stream, self._refusing():
            version = stream.readline(20)
            if version != MAGIC:
                words = printable(version.decode("ascii", "replace").strip())
                message = f"expected a bag of version 2.0, found {words!r} (rosbag migrates it)"
                raise DataFormatError(path, message)
            header, _, _ = _record(stream, len(MAGIC))
            if header.get("encryptor"):
                raise DataFormatError(path, "is an encrypted bag; decrypt it first")
        try:
            with self._refusing():
                self._index_anew() if recover else self._reader.open()
                self._reader.indexes = self._reader.places  # type: ignore[assignment]
        except DataFormatError:
            self.close()
            raise

    def close(self) -> None:
        """Close the file."""
        if self._reader.bio:
            self._reader.close()

    def losses(self) -> list[Loss]:
        """What was left out."""
        return self._losses

    def topics(self) -> list[Topic]:
        """All topics, by name."""
        return topics_of((_channel(c), self._reader.places[c.id].count()) for c in self._reader.connections)

    def messages(self, topics: Collection[str]) -> Iterator[Message]:
        """Messages of some topics, in the order of the file."""
        connections = [c for c in self._reader.connections if _channel(c).topic in topics]
        channels = {c.id: _channel(c) for c in connections}
        with self._refusing():
            for connection, log_ns, payload in self._reader.messages(connections) if connections else ():
                yield channels[connection.id], log_ns, payload

    def _index_anew(self) -> None:
        """Fill the reader with the connections and messages of all that is whole."""
        reader = self._reader
        reader.bio = stream = self.path.open("rb")
        size = stream.seek(0, 2)
        position = len(MAGIC)
        while position < size:
            start = position
            try:
                header, data, stop = _record(stream, start)
                opcode, position = header.get_uint8("op"), min(stop, size)
                if opcode == RecordType.CHUNK:
                    stream.seek(start)
                    chunk = reader.read_chunk()._replace(datasize=position - data)
                    self._index_chunk(start, stop, header.get_uint32("size"), chunk)
                elif stop > size:
                    raise DamagedError(start, "the file ends in the middle of a record")
                elif opcode == RecordType.MSGDATA:  # of a chunk whose head was never written
                    self._index_chunk(start, stop, stop - start, Chunk(stop - start, start, bytes))
                elif opcode == RecordType.CONNECTION:
                    self._connect(stream, start)
            except DataFormatError:
                raise
            except _FAULTS as error:
                position = _resume(stream, start + 1, size)
                self._losses.append(Loss(start, position, printable(str(error))))
        for key in reader.places.keys() - self._found.keys():
            words = f"{reader.places[key].count().n} messages of connection {key}, which is nowhere defined"
            self._losses.append(Loss(0, 0, words))
        reader.connections = list(self._found.values())

    def _index_chunk(self, start: int, stop: int, size: int, chunk: Chunk) -> None:
        """Index the messages of a chunk, up to where it breaks off."""
        assert self._reader.bio
        self._reader.bio.seek(chunk.datapos)
        end = chunk.datapos + chunk.datasize
        is_cut = stop > end
        try:
            content = chunk.decompressor(self._reader.bio.read(chunk.datasize))
            if len(content) != size and not is_cut:
                words = f"a chunk declares {size} bytes but holds {len(content)}"
                raise DamagedError(start, words)  # noqa: TRY301
        except DamagedError as error:
            self._losses.append(Loss(start, end, str(error)))
            return
        self._reader.chunks[start] = chunk
        if is_cut:
            words = f"the file ends within a chunk, of which {len(content)} of {size} bytes are left and read"
            self._losses.append(Loss(end, end, words))
        inner, offset = BytesIO(content), 0
        found: dict[int, list[tuple[int, int, int]]] = defaultdict(list)
        try:
            while offset < len(content):
                header, _, following = _record(inner, offset)
                if following > len(content):
                    raise DamagedError(start, "a chunk breaks off within a record")
                if header.get_uint8("op") == RecordType.MSGDATA:
                    seconds, nanoseconds = divmod(header.get_time("time"), SECOND)
                    found[header.get_uint32("conn")].append((seconds, nanoseconds, offset))
                elif header.get_uint8("op") == RecordType.CONNECTION:
                    self._connect(inner, offset)
                offset = following
        except _FAULTS as error:
            if not is_cut:
                self._losses.append(Loss(start, stop, printable(str(error))))
        for key, rows in found.items():
            self._reader.places[key].add(start, np.array(rows))

    def _connect(self, stream: BinaryIO, position: int) -> None:
        """Take the connection at a place."""
        bio, self._reader.bio = self._reader.bio, stream
        stream.seek(position)
        try:
            found = self._reader.read_connection()
        finally:
            self._reader.bio = bio
        self._found[found.id] = found

    @contextmanager
    def _refusing(self) -> Iterator[None]:
        """Say in one line what rosbags finds."""
        try:
            yield
        except DataFormatError:
            raise
        except (*_FAULTS, OSError) as error:
            if isinstance(error, OSError) and error.errno != errno.EINVAL:  # a seek to where no file reaches
                raise
            words = printable(str(error).rstrip(".") or type(error).__name__)
            message = f"is a damaged bag, near byte {self._reader.position}: {words}"
            raise DataFormatError(self.path, f"{message}; --recover reads its intact part") from None


def _channel(connection: Connection) -> Channel:
    return Channel.named(connection.topic, connection.msgtype, "ros1")


def _record(stream: BinaryIO, position: int) -> tuple[Header, int, int]:
    """Header of the record at a place, where its data begin, and where they should end."""
    stream.seek(position)
    if (n := read_length(stream)) > MAX_HEADER:
        raise DamagedError(position, f"no record begins here (a header of {n} bytes)")
    stream.seek(position)
    header = Header.read(stream)
    if header.get_uint8("op") not in set(RecordType):
        raise DamagedError(position, "no record begins here (an unknown operation)")
    n = read_length(stream)
    return header, stream.tell(), stream.tell() + n


def _resume(stream: BinaryIO, position: int, size: int) -> int:
    """Where the next chunk begins, found by the field that every chunk's header has; else the end of the file."""
    block, first = 1 << 20, position
    while position < size:
        stream.seek(position)
        window = stream.read(block + len(_CHUNK_MARK))
        mark = window.find(_CHUNK_MARK)
        while mark >= 0:
            for start in range(position + mark - 4, max(first, position + mark - 120) - 1, -1):
                try:
                    header, _, _ = _record(stream, start)
                except _FAULTS:
                    continue
                if header.get_uint8("op") == RecordType.CHUNK and {"size", "compression"} <= header.keys():
                    return start
            mark = window.find(_CHUNK_MARK, mark + 1)
        position += block
    return size
