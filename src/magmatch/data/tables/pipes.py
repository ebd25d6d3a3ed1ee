# SPDX-License-Identifier: BSD-3-Clause
"""Pipes (``<(command)``, ``/dev/stdin``, ``mkfifo``) as files: what comes through one is kept, for it comes once."""

import atexit
import os
import select
import stat
from collections.abc import Iterator
from contextlib import ExitStack
from pathlib import Path
from tempfile import TemporaryDirectory

from magmatch.data.units import MEBI
from magmatch.errors import DataFormatError

# Bytes; what a gzip file may unpack to, stated in docs/formats.md.
MOST, PIECE = 2048 * MEBI, MEBI
# Where a process has its open pipes.
OPEN = ("/dev/", "/proc/")
# s; a pipe with a name elsewhere may never have a writer: so long people take to start one by hand.
WAIT = 10.0
# Copies by device and number of the pipe, and by when one with a name was last written to; what removes them at exit.
_COPIES: dict[tuple[int, ...], Path] = {}
_AT_EXIT = ExitStack()
atexit.register(_AT_EXIT.close)


def at_rest(path: str | Path) -> Path:
    """The file itself; for a pipe, the copy of what comes through it."""
    place = Path(path)
    try:
        status = place.stat()
        if not stat.S_ISFIFO(status.st_mode):
            return place
        is_open = os.path.realpath(place).startswith(OPEN)
    except (OSError, ValueError):
        return place  # which is refused where it is read
    if (copy := _COPIES.get(_key(status, is_open=is_open))) is None:
        folder = _AT_EXIT.enter_context(TemporaryDirectory(prefix="magmatch-"))
        copy, n = Path(folder) / place.name, 0
        with copy.open("wb") as stream:
            for piece in _pieces(place, is_open=is_open):
                n += stream.write(piece)
                if n > MOST:
                    raise DataFormatError(path, f"more than {MOST} bytes come through this pipe; expected a file")
        _COPIES[_key(place.stat(), is_open=is_open)] = copy
    return copy


def _key(status: os.stat_result, *, is_open: bool) -> tuple[int, ...]:
    return (status.st_dev, status.st_ino, *(() if is_open else (status.st_mtime_ns,)))


def _pieces(place: Path, *, is_open: bool) -> Iterator[bytes]:
    """Pieces of what a pipe gives; a pipe with a name of its own is refused where it has no writer after a while."""
    handle = os.open(place, os.O_RDONLY if is_open else os.O_RDONLY | os.O_NONBLOCK)
    with os.fdopen(handle, "rb", buffering=0) as source:
        # Of a pipe whose writer is slow, read gives None.
        if not (is_open or select.select([handle], [], [], WAIT)[0]) and (first := source.read(PIECE)) is not None:
            if not first:
                raise DataFormatError(place, f"is a pipe to which nothing is written for {WAIT:g} s, expected a file")
            yield first
        os.set_blocking(handle, True)
        yield from iter(lambda: source.read(PIECE), b"")
