# SPDX-License-Identifier: BSD-3-Clause
"""MCAP files (https://mcap.dev/spec), whole or damaged.

Records are parsed by the mcap library, but walked here: its readers take a record that is cut off for a whole one,
decompress without a bound, cannot go on behind damage, and cost 5 us a message where this walk costs 1
(docs/decisions.md).
"""

import struct
import zlib
from collections.abc import Collection, Iterator
from dataclasses import dataclass, field, replace
from io import BytesIO
from pathlib import Path

import numpy as np
from mcap.data_stream import ReadDataStream
from mcap.exceptions import McapError
from mcap.opcode import Opcode
from mcap.records import Channel as ChannelRecord
from mcap.records import Schema

from magmatch.data.logs.bounds import MAX_CHUNK, DamagedError, Decompressor
from magmatch.data.logs.log import Channel, Count, Loss, Message, Topic, topics_of
from magmatch.errors import DataFormatError

MAGIC = b"\x89MCAP0\r\n"
MAX_RECORD = 16 << 20  # bytes of a record that is neither chunk nor message
RUN = 4 << 20  # bytes of messages outside any chunk that are read together
_RECORD = struct.Struct("<BQ")  # opcode, length
_MESSAGE = struct.Struct("<HIQ")  # channel, sequence, log time; a publish time of 8 bytes follows
_MESSAGE_HEAD = 22
_CHUNK = struct.Struct("<QQQII")  # first and last time, size, checksum, length of the compression's name
SCHEMA, CHANNEL, MESSAGE, CHUNK, INDEX = map(
    int, (Opcode.SCHEMA, Opcode.CHANNEL, Opcode.MESSAGE, Opcode.CHUNK, Opcode.MESSAGE_INDEX)
)
_CHAIN = 3  # records in a row that must be plausible before reading goes on behind damage
_OPCODES = range(Opcode.HEADER, Opcode.DATA_END + 1)
_PRIVATE = 0x80  # opcodes from here on are for applications
_FAULTS = (DamagedError, McapError, struct.error, ValueError)
Item = tuple[int, int, bytes]  # channel id, log time (ns), payload


@dataclass(frozen=True, slots=True)
class Part:
    """A chunk, or messages outside any chunk: where it is, how it is stored, and its index by channel id."""

    start: int
    stop: int
    body: int
    compression: str = ""
    size: int | None = None
    crc: int = 0
    index: dict[int, Count] = field(default_factory=dict)


class McapLog:
    """An MCAP file, open for reading; with `recover`, damaged pieces are left out and noted."""

    def __init__(self, path: str | Path, *, recover: bool = False) -> None:
        self.path, self._recover = Path(path), recover
        self._losses: dict[int, Loss] = {}
        self._schemas: dict[int, str] = {0: ""}
        self._channels: dict[int, Channel] = {}
        self._topics: list[Topic] | None = None
        self._decompressor = Decompressor(self.path)
        self._stream = self.path.open("rb")
        self._file_size = self._stream.seek(0, 2)
        words = ""
        if self._available(0, len(MAGIC)) != MAGIC:
            words = "is not an MCAP file of version 0"
        elif not recover and self._available(max(8, self._file_size - 8), 8) != MAGIC:
            words = "is an MCAP file without its end: cut off while recording or copying?"
        if words:
            self.close()
            raise self._refusal(words)

    def close(self) -> None:
        """Close the file."""
        self._stream.close()

    def losses(self) -> list[Loss]:
        """What was left out so far."""
        return [self._losses[start] for start in sorted(self._losses)]

    def topics(self) -> list[Topic]:
        """All topics, by name; a chunk is opened only where no index says what it holds."""
        if self._topics is None:
            counts: dict[int, Count] = {}
            for part in self._parts():
                for key, count in (part.index or self._counted(part)).items():
                    counts[key] = count.plus(counts.get(key, Count()))
            if counts.keys() - self._channels.keys():  # the summary is lost: definitions are in the chunks too
                for part in self._parts():
                    self._counted(part)
            for key in counts.keys() - self._channels.keys():
                self._lose(
                    len(MAGIC), len(MAGIC), f"{counts[key].n} messages of channel {key}, which is nowhere defined"
                )
            self._topics = topics_of((c, counts.get(key, Count())) for key, c in self._channels.items())
        return self._topics

    def messages(self, topics: Collection[str]) -> Iterator[Message]:
        """Messages of some topics; a chunk without any of them is skipped where its index says so."""
        self.topics()
        wanted = {key: channel for key, channel in self._channels.items() if channel.topic in topics}
        for part in self._parts():
            if not part.index or wanted.keys() & part.index.keys():
                for key, log_ns, payload in self._items(part, wanted):
                    yield wanted[key], log_ns, payload

    def _available(self, position: int, n: int) -> bytes:
        """Bytes from a position, as many as the file has."""
        self._stream.seek(position)
        return self._stream.read(max(0, min(n, self._file_size - position)))

    def _read(self, position: int, n: int) -> bytes:
        """Bytes from a position; DamagedError where the file ends before."""
        if position + n > self._file_size:
            raise DamagedError(
                position, f"the file ends at byte {self._file_size}, {position + n - self._file_size} too early"
            )
        return self._available(position, n)

    def _parts(self) -> Iterator[Part]:
        """Chunks with their indexes, and messages outside any chunk, in the order of the file."""
        part: Part | None = None
        position = len(MAGIC)
        while position < self._file_size:
            start = position
            try:
                found, position = self._record(start, part)
            except _FAULTS as error:
                found, position = None, self._resume(start + 1) if self._recover else self._file_size
                self._lose(start, position, str(error) or "a record is damaged")
                if part is not None:  # what follows the damage is no index of the chunk before it
                    yield part
                part = None
            if found is not None:
                if part is not None:
                    yield part
                part = found
        if part is not None:
            yield part

    def _record(self, position: int, part: Part | None) -> tuple[Part | None, int]:
        """Take one record: a new part or None, and where the next record begins."""
        head = self._available(position, _RECORD.size)
        if head == MAGIC:
            return None, self._file_size
        opcode, length = _RECORD.unpack(head)
        body, stop = position + _RECORD.size, position + _RECORD.size + length
        if opcode not in _OPCODES and opcode < _PRIVATE:
            raise DamagedError(position, f"no record begins here (opcode {opcode})")
        if opcode == CHUNK:
            return self._chunk(position, stop), min(stop, self._file_size)
        if stop > self._file_size:
            raise DamagedError(position, "the file ends in the middle of a record")
        if opcode == MESSAGE:
            stop = self._end_of_run(position, stop)
            return Part(position, stop, position), stop
        if opcode in {SCHEMA, CHANNEL, INDEX}:
            if length > MAX_RECORD:
                raise DamagedError(position, f"a record of {length} bytes, more than the {MAX_RECORD} allowed")
            content = self._read(body, length)
            if opcode == INDEX:
                (part.index if part else {}).update(_index(content))
            else:
                self._define(opcode, content)
        return None, stop

    def _chunk(self, position: int, stop: int) -> Part:
        """The head of a chunk, whose content may be cut off."""
        at = position + _RECORD.size
        first, last, size, crc, n_name = _CHUNK.unpack(self._read(at, _CHUNK.size))
        if n_name > 32 or first > last:
            raise DamagedError(position, "the head of a chunk is damaged")
        name = self._read(at + _CHUNK.size, n_name + 8)
        body = at + _CHUNK.size + n_name + 8
        if body + int.from_bytes(name[n_name:], "little") != stop:
            raise DamagedError(position, "the lengths in the head of a chunk do not fit each other")
        return Part(position, stop, body, name[:n_name].decode("ascii", "replace"), size, crc)

    def _end_of_run(self, position: int, stop: int) -> int:
        """Where messages end that stand side by side outside any chunk; a few MB of them, or one."""
        window, at = self._available(position, RUN), 0
        while at + _RECORD.size <= len(window):
            opcode, length = _RECORD.unpack_from(window, at)
            if opcode != MESSAGE or length < _MESSAGE_HEAD or at + _RECORD.size + length > len(window):
                break
            at += _RECORD.size + length
        return max(stop, position + at)

    def _define(self, opcode: int, content: bytes) -> None:
        """Take a schema or a channel."""
        record = (Schema if opcode == SCHEMA else ChannelRecord).read(ReadDataStream(BytesIO(content)))
        if isinstance(record, Schema):
            self._schemas[record.id] = record.name
        elif record.schema_id in self._schemas:
            kind = self._schemas[record.schema_id]
            self._channels[record.id] = Channel.named(record.topic, kind, record.message_encoding)
        else:
            raise DamagedError(
                record.id, f"channel {record.id} refers to schema {record.schema_id}, which is nowhere defined"
            )

    def _items(self, part: Part, wanted: Collection[int] | None) -> Iterator[Item]:
        """Messages of some channels in a part (all by default), up to where it breaks off."""
        is_cut = part.stop > self._file_size
        try:
            if part.stop - part.body > MAX_CHUNK:
                raise DamagedError(
                    part.start, f"a chunk of {part.stop - part.body} bytes, more than the {MAX_CHUNK} allowed"
                )
            if is_cut and not self._recover:
                raise DamagedError(part.start, "the file ends in the middle of a chunk")
            raw = self._available(part.body, part.stop - part.body)
            body = self._decompressor.expand(part.compression, raw, part.size)
            if is_cut:
                words = f"the file ends within a chunk, of which {len(body)} of {part.size} bytes are left and read"
                self._lose(self._file_size, self._file_size, words)
            elif part.size not in {None, len(body)}:
                raise DamagedError(part.start, f"a chunk declares {part.size} bytes but holds {len(body)}")
            elif part.crc and zlib.crc32(body) != part.crc:
                raise DamagedError(part.start, "the checksum of a chunk does not fit its content")
            yield from self._walk(body, wanted)
        except DataFormatError:
            raise
        except _FAULTS as error:
            if not is_cut or not self._recover or self._file_size not in self._losses:
                self._lose(part.start, min(part.stop, self._file_size), str(error) or "a record is damaged")

    def _walk(self, body: bytes, wanted: Collection[int] | None) -> Iterator[Item]:
        """Messages in the content of a chunk; definitions are taken on the way."""
        position, end = 0, len(body)
        record, message = _RECORD.unpack_from, _MESSAGE.unpack_from
        while position < end:
            opcode, length = record(body, position)
            position += 9
            stop = position + length
            if stop > end or (opcode == MESSAGE and length < _MESSAGE_HEAD):
                raise DamagedError(position, "a chunk breaks off within a record")
            if opcode == MESSAGE:
                channel, _, log_ns = message(body, position)
                if log_ns >> 63:
                    raise DamagedError(position, f"a message of the year {1970 + log_ns // 31_556_952_000_000_000}")
                if wanted is None or channel in wanted:
                    yield channel, log_ns, body[position + _MESSAGE_HEAD : stop]
            elif opcode in {SCHEMA, CHANNEL}:
                self._define(opcode, body[position:stop])
            else:
                raise DamagedError(position, f"a chunk holds a record of operation {opcode}")
            position = stop

    def _counted(self, part: Part) -> dict[int, Count]:
        """Messages of a part counted one by one."""
        counts: dict[int, Count] = {}
        for key, log_ns, _ in self._items(part, None):
            counts[key] = counts.get(key, Count()).plus(Count(1, log_ns, log_ns))
        return counts

    def _resume(self, position: int) -> int:
        """The next place where some plausible records follow each other, or the end of the file."""
        block = 1 << 20
        while position < self._file_size:
            window = self._available(position, block + 8)
            marks = np.isin(np.frombuffer(window[:block], np.uint8), (CHUNK, MESSAGE))
            for at in np.flatnonzero(marks).tolist():
                if self._is_plausible(position + at, window[at : at + 9]):
                    return int(position + at)
            position += block
        return self._file_size

    def _is_plausible(self, position: int, head: bytes) -> bool:
        """Whether a few records in a row, or up to the end of the file, have possible opcodes and lengths."""
        for _ in range(_CHAIN):
            if len(head) < _RECORD.size:
                return head in {MAGIC, b""}
            opcode, length = _RECORD.unpack(head)
            following = position + _RECORD.size + length
            if opcode not in _OPCODES or following > self._file_size:
                return False
            if opcode == MESSAGE and length < _MESSAGE_HEAD:
                return False
            if opcode == CHUNK:
                try:
                    self._chunk(position, following)
                except DamagedError:
                    return False
                return True  # lengths of 64 bits that fit each other are no accident
            position, head = following, self._available(following, _RECORD.size)
        return True

    def _lose(self, start: int, stop: int, words: str) -> None:
        """Refuse the damage, or note it once."""
        if not self._recover:
            words = f"damaged at byte {start}: {words}"
            raise self._refusal(words)
        known = self._losses.get(start, Loss(start, stop, words))
        self._losses[start] = replace(known, stop=max(known.stop, stop))

    def _refusal(self, words: str) -> DataFormatError:
        return DataFormatError(self.path, f"{words}; --recover reads its intact part")


def _index(content: bytes) -> dict[int, Count]:
    """How many messages of a channel the chunk before holds, and when; in Python mcap takes 2 us for each."""
    key, n_bytes = struct.unpack_from("<HI", content)
    if n_bytes != len(content) - 6 or n_bytes % 16:
        raise DamagedError(key, "a message index whose lengths do not fit")
    times = np.frombuffer(content, "<u8", offset=6)[::2]
    if len(times) and int(times.max()) >> 63:
        raise DamagedError(key, "a message index beyond all calendars")
    return {key: Count(len(times), int(times.min()), int(times.max()))} if len(times) else {}
