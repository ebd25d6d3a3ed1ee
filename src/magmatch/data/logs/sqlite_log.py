# SPDX-License-Identifier: BSD-3-Clause
"""The SQLite files of ROS 2 bags: tables ``topics`` and ``messages``."""

import sqlite3
from collections import deque
from collections.abc import Collection, Iterator
from contextlib import contextmanager
from pathlib import Path
from urllib.parse import quote

from magmatch.data.logs.log import Batch, Batcher, Channel, Loss, Topic, printable
from magmatch.data.logs.source import MAX_CHUNK
from magmatch.data.tables.text import read_bytes
from magmatch.errors import DataFormatError

# The last of them: names in a damaged file are no UTF-8.
SQLITE_ERRORS = (sqlite3.Error, OverflowError, UnicodeDecodeError)
MAX_STEP = 1 << 40  # how far behind a damage the next message is looked for, in message numbers
# Steps of SQLite's machine; counting and reading honest messages takes less than one for each byte.
WORK, WORK_PER_BYTE, WORK_STEP = 10_000_000, 5, 100_000
Row = tuple[int, int, int, bytes]  # id, topic, log time (ns), payload


class SqliteLog:
    """A ``.db3`` file, open for reading.

    Parameters
    ----------
    path : path
        The file.
    recover : bool
        Pass over messages on damaged pages and note them, instead of refusing.
    """

    def __init__(self, path: str | Path, *, recover: bool = False) -> None:
        self.path, self._recover = Path(path), recover
        self._losses: dict[str, Loss] = {}
        self._is_searched = False
        self._suspect = _bytes_cut(self.path)
        self._work_left = WORK + WORK_PER_BYTE * self.path.stat().st_size
        with self._refusing():
            self._database = _open(self.path, recover=recover)
        self._database.set_progress_handler(self._is_too_much, WORK_STEP)
        try:
            with self._refusing():
                self._channels = self._read_channels()
        except DataFormatError:
            self.close()
            raise

    def close(self) -> None:
        """Let go of the file."""
        self._database.close()

    def losses(self) -> list[Loss]:
        """What was left out so far."""
        return list(self._losses.values())

    def topics(self) -> list[Topic]:
        """All topics, by name."""
        counts: dict[int, tuple[int, int, int]] = {}
        query = "SELECT topic_id, count(*), min(timestamp), max(timestamp) FROM messages GROUP BY topic_id"
        try:
            with self._refusing():
                counts = {key: (n, first, last) for key, n, first, last in self._database.execute(query)}
        except DataFormatError:
            if not self._recover:
                raise
            for _, key, log_ns, _ in self._rows(set(self._channels)):
                n, first, last = counts.get(key, (0, log_ns, log_ns))
                counts[key] = (n + 1, min(first, log_ns), max(last, log_ns))
            self._is_searched = True
        topics = [
            Topic(channel.topic, channel.type, channel.encoding, *self._checked(counts.get(key, (0, 0, 0))))
            for key, channel in self._channels.items()
        ]
        return sorted(topics, key=lambda topic: (topic.name, topic.type))

    def messages(self, topics: Collection[str]) -> Iterator[Batch]:
        """Messages of some topics, in the order in which they were written."""
        batcher = Batcher()
        for _, key, log_ns, payload in self._rows({k for k, c in self._channels.items() if c.topic in topics}):
            batch = batcher.add(key, self._channels[key], log_ns, payload)
            if batch is not None:
                yield batch
        yield from batcher.rest()

    def _rows(self, wanted: set[int]) -> Iterator[Row]:
        """Rows of some topics; where a page is damaged, go on behind it."""
        if not self._suspect:
            yield from self._readable_rows(wanted)
            return
        held: deque[Row] = deque()
        n_held = 0
        for row in self._readable_rows(wanted):
            held.append(row)
            n_held += len(row[3])
            while held and n_held - len(held[0][3]) >= self._suspect:
                n_held -= len(held[0][3])
                yield held.popleft()
        if held:  # they may lie on the page in which the file ends, whose missing part SQLite takes for zeros
            self._note(f"messages {held[0][0]} to {held[-1][0]} may lie on the page in which the file ends")

    def _readable_rows(self, wanted: set[int]) -> Iterator[Row]:
        """Rows that SQLite gives."""
        marks = ",".join(str(int(key)) for key in wanted)
        query = (
            f"SELECT id, topic_id, timestamp, data FROM messages WHERE id > ? AND topic_id IN ({marks}) ORDER BY id"
        )
        last, step = -(1 << 62), 0
        while step < MAX_STEP:
            try:
                for row in self._database.execute(query, (last + step,)):
                    number, key, log_ns, payload = row
                    # Spelled out: this loop is what reading a bag costs.
                    if not (type(number) is type(key) is type(log_ns) is int and type(payload) is bytes):
                        raise DataFormatError(self.path, f"message {number} has no number, time stamp or data")
                    if number <= last + step:
                        msg = "its rows do not follow each other"
                        raise sqlite3.DatabaseError(msg)
                    if step:
                        self._note(f"messages {last + 1} to {number - 1} lie on damaged pages")
                    last, step = number, 0
                    yield row
            except SQLITE_ERRORS as error:
                if not self._recover:
                    raise self._refusal(error) from None
                last = max(last, 0)  # identifiers count from 1
                step = 2 * step or 1
                continue
            break
        if step:
            self._note(f"messages after {last} lie on damaged pages")

    def _is_too_much(self) -> bool:
        """Stop a query that runs on and on: damaged pages may lead in circles."""
        self._work_left -= WORK_STEP
        return self._work_left < 0

    def _note(self, words: str) -> None:
        """Keep what was lost; a later look at some topics alone would say it again in other words."""
        if not self._is_searched:
            self._losses[words] = Loss(0, 0, words)

    def _read_channels(self) -> dict[int, Channel]:
        """Topics by number; only true tables are asked, since a view could compute without end."""
        tables = {name for (name,) in self._database.execute("SELECT name FROM sqlite_master WHERE type = 'table'")}
        missing = {"topics", "messages"} - tables
        if missing:
            message = f"is a SQLite database without table {', '.join(sorted(missing))}: not a ROS 2 bag"
            raise DataFormatError(self.path, message)
        channels = {}
        for key, name, kind, encoding in self._database.execute(
            "SELECT id, name, type, serialization_format FROM topics"
        ):
            if not isinstance(key, int) or not all(isinstance(text, str) for text in (name, kind, encoding)):
                raise DataFormatError(self.path, "its table of topics holds other things than names")
            channels[key] = Channel.named(name, kind, encoding)
        return channels

    def _checked(self, count: tuple[object, object, object]) -> tuple[int, int, int]:
        if not all(isinstance(number, int) for number in count):
            raise DataFormatError(self.path, "holds messages whose time stamp is no whole number")
        n, first, last = count
        return n, first, last  # type: ignore[return-value]

    def _refusal(self, error: Exception) -> DataFormatError:
        return DataFormatError(
            self.path,
            f"is a damaged ROS 2 bag (SQLite: {printable(str(error))}); --recover reads all that is whole of it",
        )

    @contextmanager
    def _refusing(self) -> Iterator[None]:
        """Say in words what SQLite finds."""
        try:
            yield
        except SQLITE_ERRORS as error:
            raise self._refusal(error) from None


def _bytes_cut(path: Path) -> int:
    """Length of the page in which a file ends too early; 0 where it does not."""
    head = read_bytes(path, 100)
    page = {1: 65_536}.get(int.from_bytes(head[16:18], "big"), int.from_bytes(head[16:18], "big"))
    n_pages, size = int.from_bytes(head[28:32], "big"), path.stat().st_size
    return page if page and size % page and size < n_pages * page else 0


def _open(path: Path, *, recover: bool) -> sqlite3.Connection:
    """Open read-only, with nothing in the file trusted."""
    # Where the recorder left a journal, SQLite has to look at it; else the file is not even locked.
    journal = path.with_name(path.name + "-wal")
    mode = "mode=ro" if journal.exists() and journal.stat().st_size else "mode=ro&immutable=1"
    database = sqlite3.connect(f"file:{quote(str(path.resolve()))}?{mode}", uri=True)
    database.text_factory = lambda raw: raw.decode("utf-8", "replace")
    database.setlimit(sqlite3.SQLITE_LIMIT_LENGTH, MAX_CHUNK)
    database.execute("PRAGMA trusted_schema = OFF")
    if recover:  # lets SQLite look into a file that is shorter than its header says
        database.execute("PRAGMA writable_schema = ON")
    return database
