# SPDX-License-Identifier: BSD-3-Clause
"""The SQLite files of ROS 2 bags: tables ``topics`` and ``messages``, read by SQLite itself.

Not by rosbags, whose reader sorts by time, takes any row and any query for honest, leaves a journal unread, and stops
at the first damaged page.
"""

import sqlite3
from collections import deque
from collections.abc import Collection, Iterator
from contextlib import contextmanager
from pathlib import Path
from urllib.parse import quote

from magmatch.data.logs.bounds import MAX_CHUNK
from magmatch.data.logs.log import Channel, Count, Loss, Message, Topic, printable, topics_of
from magmatch.data.tables.text import read_bytes
from magmatch.errors import DataFormatError

SQLITE_ERRORS = (sqlite3.Error, OverflowError, UnicodeDecodeError)  # the last: names in a damaged file
MAX_STEP = 1 << 40  # how far behind damage the next message is looked for, in message numbers
# Steps of SQLite's machine; counting and reading honest messages takes less than one for each byte.
WORK, WORK_PER_BYTE, WORK_STEP = 10_000_000, 5, 100_000
Row = tuple[int, int, int, bytes]  # id, topic, log time (ns), payload


class SqliteLog:
    """A ``.db3`` file, open for reading; with `recover`, messages on damaged pages are left out and noted."""

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
        """Close the file."""
        self._database.close()

    def losses(self) -> list[Loss]:
        """What was left out so far."""
        return list(self._losses.values())

    def topics(self) -> list[Topic]:
        """All topics, by name."""
        counts: dict[int, Count] = {}
        query = "SELECT topic_id, count(*), min(timestamp), max(timestamp) FROM messages GROUP BY topic_id"
        try:
            with self._refusing():
                counts = {key: Count(*found) for key, *found in self._database.execute(query)}
        except DataFormatError:
            if not self._recover:
                raise
            for _, key, log_ns, _ in self._rows(set(self._channels)):
                counts[key] = counts.get(key, Count()).plus(Count(1, log_ns, log_ns))
            self._is_searched = True
        counts = {key: counts.get(key, Count()) for key in self._channels}
        if not all(isinstance(number, int) for count in counts.values() for number in count):
            raise DataFormatError(self.path, "holds messages whose time stamp is no whole number")
        return topics_of((channel, counts[key]) for key, channel in self._channels.items())

    def messages(self, topics: Collection[str]) -> Iterator[Message]:
        """Messages of some topics, in the order in which they were written."""
        wanted = {key: channel for key, channel in self._channels.items() if channel.topic in topics}
        for _, key, log_ns, payload in self._rows(wanted):
            yield wanted[key], log_ns, payload

    def _rows(self, wanted: Collection[int]) -> Iterator[Row]:
        """Rows of some topics, but those that may lie on the page in which a file ends."""
        held: deque[Row] = deque()
        n_held = 0
        for row in self._readable_rows(wanted):
            held.append(row)
            n_held += len(row[3])
            while held and n_held - len(held[0][3]) >= self._suspect:
                n_held -= len(held[0][3])
                yield held.popleft()
        if held:  # SQLite takes the missing part of that page for zeros
            self._note(f"messages {held[0][0]} to {held[-1][0]} may lie on the page in which the file ends")

    def _readable_rows(self, wanted: Collection[int]) -> Iterator[Row]:
        """Rows of some topics; where a page is damaged, from the next readable one on."""
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
        """Whether to stop a query that runs on and on: damaged pages may lead in circles."""
        self._work_left -= WORK_STEP
        return self._work_left < 0

    def _note(self, words: str) -> None:
        """Keep what was lost; a later pass over some topics would repeat it in other words."""
        if not self._is_searched:
            self._losses[words] = Loss(0, 0, words)

    def _read_channels(self) -> dict[int, Channel]:
        """Topics by number; only true tables are asked, since a view could compute without end."""
        tables = {name for (name,) in self._database.execute("SELECT name FROM sqlite_master WHERE type = 'table'")}
        missing = {"topics", "messages"} - tables
        if missing:
            message = f"is a SQLite database without table {', '.join(sorted(missing))}: not a ROS 2 bag"
            raise DataFormatError(self.path, message)
        rows = self._database.execute("SELECT id, name, type, serialization_format FROM topics").fetchall()
        if not all(isinstance(key, int) and all(isinstance(text, str) for text in texts) for key, *texts in rows):
            raise DataFormatError(self.path, "its table of topics holds other things than names")
        return {key: Channel.named(*texts) for key, *texts in rows}

    def _refusal(self, error: Exception) -> DataFormatError:
        words = f"is a damaged ROS 2 bag (SQLite: {printable(str(error))})"
        return DataFormatError(self.path, f"{words}; --recover reads its intact part")

    @contextmanager
    def _refusing(self) -> Iterator[None]:
        """Say in one line what SQLite finds."""
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
