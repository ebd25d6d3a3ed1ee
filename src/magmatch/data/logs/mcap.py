# SPDX-License-Identifier: BSD-3-Clause
"""The layout of MCAP files (https://mcap.dev/spec): records of opcode, length and content."""

import struct
import zlib
from collections.abc import Collection, Iterator

import numpy as np

from magmatch.data.logs.chunked import Chunk, Count, Definition, Index, Loose, Message, Piece
from magmatch.data.logs.log import Channel
from magmatch.data.logs.source import MAX_CHUNK, MAX_RECORD, DamagedError, Source
from magmatch.errors import DataFormatError

MAGIC = b"\x89MCAP0\r\n"
SCHEMA, CHANNEL, MESSAGE, CHUNK, MESSAGE_INDEX, DATA_END, LAST_OPCODE = 0x03, 0x04, 0x05, 0x06, 0x07, 0x0F, 0x0F
_RECORD = struct.Struct("<BQ")
_MESSAGE = struct.Struct("<HIQQ")  # channel, sequence, log time, publish time
_CHUNK = struct.Struct("<QQQII")  # first and last time, size, crc, length of the compression's name
RUN = 4 << 20  # bytes of messages outside any chunk that are read together
_CHAIN = 3  # records in a row that must be plausible before reading goes on behind a damage


class McapContainer:
    """Layout of MCAP; remembers schemas, which channels refer to."""

    def __init__(self) -> None:
        self._schemas: dict[int, str] = {0: ""}

    def begin(self, source: Source) -> int:
        """Check the magic bytes."""
        if source.read_available(0, len(MAGIC)) != MAGIC:
            raise DataFormatError(source.path, "is not an MCAP file of version 0")
        return len(MAGIC)

    def doubt(self, source: Source) -> str | None:
        """A whole file ends as it begins."""
        tail = source.read(source.size - len(MAGIC), len(MAGIC)) if source.size >= 2 * len(MAGIC) else b""
        return None if tail == MAGIC else "is an MCAP file without its end: cut off while recording or copying?"

    def piece(self, source: Source, position: int) -> tuple[Piece, int]:
        """Read one record."""
        if source.size - position == len(MAGIC) and source.read(position, len(MAGIC)) == MAGIC:
            return None, source.size
        opcode, length = _RECORD.unpack(source.read(position, _RECORD.size))
        body = position + _RECORD.size
        stop = body + length
        if not 0 < opcode <= LAST_OPCODE and opcode < 0x80:
            raise DamagedError(position, f"no record begins here (opcode {opcode})")
        if opcode == CHUNK:
            return _chunk(source, position, body, stop), min(stop, source.size)
        if stop > source.size:
            raise DamagedError(position, "the file ends in the middle of a record")
        if opcode == MESSAGE:
            stop = _end_of_run(source, position, stop)
            return Loose(position, stop, position), stop
        if opcode in {SCHEMA, CHANNEL, MESSAGE_INDEX}:
            if length > MAX_RECORD:
                raise DamagedError(position, f"a record declares {length} bytes, more than the {MAX_RECORD} allowed")
            content = source.read(body, length)
            try:
                return (_index(content) if opcode == MESSAGE_INDEX else self._definition(opcode, content)), stop
            except (struct.error, ValueError) as error:
                raise DamagedError(position, f"a record is damaged ({error})") from None
        return None, stop

    def contents(self, body: bytes, start: int, wanted: Collection[int] | None) -> Iterator[Message | Definition]:
        """Walk the records of a chunk."""
        position, end = start, len(body)
        record, message = _RECORD.unpack_from, _MESSAGE.unpack_from
        while position < end:
            if position + 9 > end:
                msg = "a chunk breaks off within a record"
                raise ValueError(msg)
            opcode, length = record(body, position)
            position += 9
            stop = position + length
            if stop > end or (opcode == MESSAGE and length < 22):
                msg = "a chunk breaks off within a record"
                raise ValueError(msg)
            if opcode == MESSAGE:
                channel, _, log_ns, _ = message(body, position)
                if log_ns >> 63:
                    msg = f"a message of the year {1970 + log_ns // 31_556_952_000_000_000}"
                    raise ValueError(msg)
                if wanted is None or channel in wanted:
                    yield channel, log_ns, position + 22, stop
            elif opcode in {SCHEMA, CHANNEL}:
                try:
                    definition = self._definition(opcode, body[position:stop])
                except struct.error:
                    msg = "a schema or channel is damaged"
                    raise ValueError(msg) from None
                if definition is not None:
                    yield definition
            else:
                msg = f"a chunk holds a record of operation {opcode}"
                raise ValueError(msg)
            position = stop

    def verify(self, chunk: Chunk, body: bytes) -> None:
        """Compare the checksum, where there is one."""
        if chunk.crc and zlib.crc32(body) != chunk.crc:
            raise DamagedError(chunk.start, "the checksum of a chunk does not fit its content")

    def resume(self, source: Source, position: int) -> int | None:
        """Next place where some plausible records follow each other."""
        block = 1 << 20
        while position < source.size:
            window = source.read_available(position, block + 8)
            for at in np.flatnonzero(np.isin(np.frombuffer(window[:block], np.uint8), (CHUNK, MESSAGE))).tolist():
                if _is_plausible(source, position + at, window[at : at + 9]):
                    return position + int(at)
            position += block
        return None

    def _definition(self, opcode: int, content: bytes) -> Definition | None:
        if opcode == SCHEMA:
            (key,) = struct.unpack_from("<H", content)
            name, _ = _text(content, 2)
            self._schemas[key] = name
            return None
        key, schema = struct.unpack_from("<HH", content)
        topic, after = _text(content, 4)
        encoding, _ = _text(content, after)
        if schema not in self._schemas:
            msg = f"channel {key} refers to schema {schema}, which is nowhere defined"
            raise ValueError(msg)
        return Definition(key, Channel.named(topic, self._schemas[schema], encoding))


def _chunk(source: Source, position: int, body: int, stop: int) -> Chunk:
    """The head of a chunk record, whose content may be cut off."""
    first, last, size, crc, n_name = _CHUNK.unpack(source.read(body, _CHUNK.size))
    if n_name > 32 or first > last:
        raise DamagedError(position, "the head of a chunk is damaged")
    name = source.read(body + _CHUNK.size, n_name).decode("ascii", "replace")
    (n_records,) = struct.unpack("<Q", source.read(body + _CHUNK.size + n_name, 8))
    start = body + _CHUNK.size + n_name + 8
    if start + n_records != stop:
        raise DamagedError(position, "the lengths in the head of a chunk do not fit each other")
    return Chunk(position, stop, start, name or "none", size, crc)


def _end_of_run(source: Source, position: int, stop: int) -> int:
    """Where messages end that stand side by side outside any chunk; a few MB of them, or one."""
    if stop - position > MAX_CHUNK:
        raise DamagedError(position, f"a message of {stop - position} bytes, more than the {MAX_CHUNK} allowed")
    window, at = source.read_available(position, RUN), 0
    while at + _RECORD.size <= len(window):
        opcode, length = _RECORD.unpack_from(window, at)
        if opcode != MESSAGE or length < _MESSAGE.size or at + _RECORD.size + length > len(window):
            break
        at += _RECORD.size + length
    return max(stop, position + at)


def _index(content: bytes) -> Index | None:
    """How many messages of a channel the chunk before holds, and when."""
    key, n_bytes = struct.unpack_from("<HI", content)
    times = np.frombuffer(content[6 : len(content) - (len(content) - 6) % 16], "<u8")[::2]
    if n_bytes != len(content) - 6 or n_bytes % 16 or (len(times) and int(times.max()) >> 63):
        msg = "a message index whose lengths do not fit"
        raise ValueError(msg)
    return Index(key, Count(len(times), int(times.min()), int(times.max()))) if len(times) else None


def _text(content: bytes, at: int) -> tuple[str, int]:
    """A string, and where what follows it begins."""
    (n,) = struct.unpack_from("<I", content, at)
    if n > len(content) - at - 4:
        msg = f"a string of {n} bytes in a record of {len(content)}"
        raise ValueError(msg)
    return content[at + 4 : at + 4 + n].decode("utf-8", "replace"), at + 4 + n


def _is_plausible(source: Source, position: int, head: bytes) -> bool:
    """Whether a few records in a row, or up to the end of the file, have possible opcodes and lengths."""
    for _ in range(_CHAIN):
        if len(head) < _RECORD.size:
            return head == MAGIC
        opcode, length = _RECORD.unpack(head)
        following = position + _RECORD.size + length
        if not 0 < opcode <= LAST_OPCODE or following > source.size or (opcode == MESSAGE and length < 22):
            return False
        if opcode == CHUNK:
            try:
                _chunk(source, position, position + _RECORD.size, following)
            except DamagedError:
                return False
            return True  # lengths of 64 bits that fit each other are no accident
        position, head = following, source.read_available(following, _RECORD.size)
        if not head:
            return True
    return True
