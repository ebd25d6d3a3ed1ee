# SPDX-License-Identifier: BSD-3-Clause
"""The layout of ROS 1 bags (http://wiki.ros.org/Bags/Format/2.0): records of named fields and data."""

import struct
from collections.abc import Collection, Iterator

import numpy as np

from magmatch.data.logs.chunked import Chunk, Count, Definition, Index, Loose, Message, Piece
from magmatch.data.logs.log import Channel
from magmatch.data.logs.source import MAX_RECORD, DamagedError, Source
from magmatch.errors import DataFormatError

MAGIC = b"#ROSBAG V2.0\n"
MESSAGE, BAG_HEADER, INDEX, CHUNK, CONNECTION = 0x02, 0x03, 0x04, 0x05, 0x07
OPCODES = range(0x02, 0x08)
MAX_HEADER = 64 << 10
_UINT32 = struct.Struct("<I")
_TIME = struct.Struct("<II")
_CHUNK_MARK = b"\x04\x00\x00\x00op=\x05"


class Ros1Container:
    """Layout of ROS 1 bags, version 2.0."""

    def begin(self, source: Source) -> int:
        """Check version and encryption."""
        if source.read_available(0, len(MAGIC)) != MAGIC:
            version = source.read_available(0, 20).split(b"\n")[0].decode("ascii", "replace")
            raise DataFormatError(
                source.path, f"expected a bag of version 2.0, found {version!r} (rosbag migrates it)"
            )
        fields, _, _ = _record(source, len(MAGIC))
        if fields.get(b"encryptor"):
            raise DataFormatError(source.path, "is an encrypted bag; decrypt it first")
        return len(MAGIC)

    def doubt(self, source: Source) -> str | None:
        """A bag that was closed knows where its index lies, and the index lies within the file."""
        fields, _, _ = _record(source, len(MAGIC))
        position = int.from_bytes(fields.get(b"index_pos", b"")[:8], "little")
        if _opcode(fields) != BAG_HEADER:
            return "is a bag whose header is damaged"
        if position == 0:
            return "is a bag that was never closed (no index: the recorder was stopped hard?)"
        return None if position <= source.size else "is a bag without its end: cut off while copying?"

    def piece(self, source: Source, position: int) -> tuple[Piece, int]:
        """Read one record."""
        fields, data, stop = _record(source, position)
        opcode = _opcode(fields)
        if opcode not in OPCODES:
            raise DamagedError(position, f"no record begins here (opcode {opcode})")
        if opcode == CHUNK:
            name = fields.get(b"compression", b"?").decode("ascii", "replace")
            size = _number(fields, b"size", position)
            return Chunk(position, stop, data, name, size), min(stop, source.size)
        if stop > source.size:
            raise DamagedError(position, "the file ends in the middle of a record")
        if opcode == MESSAGE:
            return Loose(position, stop, position), stop
        if opcode not in {INDEX, CONNECTION}:
            return None, stop
        if stop - data > MAX_RECORD:
            raise DamagedError(position, f"a record declares {stop - data} bytes, more than the {MAX_RECORD} allowed")
        content = source.read(data, stop - data)
        if opcode == CONNECTION:
            try:
                return _definition(fields, content), stop
            except ValueError as error:
                raise DamagedError(position, str(error)) from None
        return _index(fields, content, position), stop

    def contents(self, body: bytes, start: int, wanted: Collection[int] | None) -> Iterator[Message | Definition]:
        """Walk the records of a chunk."""
        position, end = start, len(body)
        uint32 = _UINT32.unpack_from
        broken = "a chunk breaks off within a record"
        while position < end:
            if position + 4 > end:
                raise ValueError(broken)
            header = position + 4
            data = header + uint32(body, position)[0] + 4
            if data > end:
                raise ValueError(broken)
            stop = data + uint32(body, data - 4)[0]
            if stop > end:
                raise ValueError(broken)
            fields = _fields(body[header : data - 4])
            opcode = _opcode(fields)
            if opcode == MESSAGE:
                key, moment = fields.get(b"conn", b""), fields.get(b"time", b"")
                if len(key) != 4 or len(moment) != 8:
                    msg = "a message without connection or time"
                    raise ValueError(msg)
                channel = int.from_bytes(key, "little")
                if wanted is None or channel in wanted:
                    yield channel, _nanoseconds(moment), data, stop
            elif opcode == CONNECTION:
                yield _definition(fields, body[data:stop])
            elif opcode not in OPCODES:
                msg = "a record without a known operation in a chunk"
                raise ValueError(msg)
            position = stop

    def verify(self, chunk: Chunk, body: bytes) -> None:
        """Bags have no checksum of their own."""

    def resume(self, source: Source, position: int) -> int | None:
        """Next chunk, found by the field that every chunk's header has."""
        block = 1 << 20
        while position < source.size:
            window = source.read_available(position, block + len(_CHUNK_MARK))
            mark = window.find(_CHUNK_MARK)
            while mark >= 0:
                start = _start_of_chunk(source, position + mark, position)
                if start is not None:
                    return start
                mark = window.find(_CHUNK_MARK, mark + 1)
            position += block
        return None


def _record(source: Source, position: int) -> tuple[dict[bytes, bytes], int, int]:
    """Fields of a record, where its data begin and where they should end."""
    n_header = _UINT32.unpack(source.read(position, 4))[0]
    if n_header > MAX_HEADER:
        raise DamagedError(position, f"no record begins here (a header of {n_header} bytes)")
    try:
        fields = _fields(source.read(position + 4, n_header))
    except ValueError as error:
        raise DamagedError(position, str(error)) from None
    data = position + 4 + n_header + 4
    return fields, data, data + _UINT32.unpack(source.read(data - 4, 4))[0]


def _fields(header: bytes) -> dict[bytes, bytes]:
    """Named fields of a header; ValueError where it is none."""
    fields, position, end = {}, 0, len(header)
    while position < end:
        if position + 4 > end:
            msg = "a record's header breaks off"
            raise ValueError(msg)
        start = position + 4
        position = start + _UINT32.unpack_from(header, position)[0]
        name, mark, value = header[start:position].partition(b"=")
        if position > end or not mark:
            msg = "a record's header is damaged"
            raise ValueError(msg)
        fields[name] = value
    return fields


def _opcode(fields: dict[bytes, bytes]) -> int:
    value = fields.get(b"op", b"")
    return value[0] if len(value) == 1 else -1


def _number(fields: dict[bytes, bytes], name: bytes, position: int) -> int:
    value = fields.get(name, b"")
    if len(value) != 4:
        raise DamagedError(position, f"a record without its {name.decode()}")
    return int.from_bytes(value, "little")


def _nanoseconds(moment: bytes) -> int:
    seconds, nanoseconds = _TIME.unpack(moment)
    return int(seconds * 1_000_000_000 + nanoseconds)


def _definition(fields: dict[bytes, bytes], content: bytes) -> Definition:
    """A connection; what the publisher named (the topic may be remapped) stands in its data."""
    about, key = _fields(content), fields.get(b"conn", b"")
    if len(key) != 4 or b"type" not in about:
        msg = "a connection without number or type"
        raise ValueError(msg)
    topic = fields.get(b"topic", about.get(b"topic", b"")).decode("utf-8", "replace")
    name = about[b"type"].decode("utf-8", "replace")
    return Definition(int.from_bytes(key, "little"), Channel.named(topic, name, "ros1"))


def _index(fields: dict[bytes, bytes], content: bytes, position: int) -> Index | None:
    """How many messages of a connection the chunk before holds, and when."""
    key, n = _number(fields, b"conn", position), _number(fields, b"count", position)
    if _number(fields, b"ver", position) != 1 or n * 12 != len(content):
        raise DamagedError(position, "an index whose lengths do not fit")
    if not n:
        return None
    rows = np.frombuffer(content, "<u4").reshape(n, 3).astype(np.int64)
    times = rows[:, 0] * 1_000_000_000 + rows[:, 1]
    return Index(key, Count(n, int(times.min()), int(times.max())))


def _start_of_chunk(source: Source, mark: int, earliest: int) -> int | None:
    """Where the record begins whose header has a field at this place."""
    for start in range(mark - 4, max(earliest, mark - 120) - 1, -1):
        try:
            fields, _, _ = _record(source, start)
        except DamagedError:
            continue
        if _opcode(fields) == CHUNK and len(fields.get(b"size", b"")) == 4 and b"compression" in fields:
            return start
    return None
