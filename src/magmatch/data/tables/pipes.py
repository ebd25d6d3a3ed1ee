# SPDX-License-Identifier: BSD-3-Clause
"""Pipes (``<(command)``, ``/dev/stdin``) as files: what comes through one is kept, since it comes only once."""

import atexit
import stat
from contextlib import ExitStack
from os.path import realpath
from pathlib import Path
from tempfile import TemporaryDirectory

from magmatch.errors import DataFormatError

# Bytes; what a gzip file may unpack to, stated in docs/formats.md.
MOST = 2 << 30
PIECE = 4 << 20
# Where a process has its open pipes. A pipe with a name elsewhere might wait for ever for someone to write to it.
OPEN = ("/dev/", "/proc/")
# Copies by device and number of the pipe, and what removes them at exit.
_COPIES: dict[tuple[int, int], Path] = {}
_AT_EXIT = ExitStack()
atexit.register(_AT_EXIT.close)


def at_rest(path: str | Path) -> Path:
    """The file itself; for an open pipe, the copy of what comes through it."""
    place = Path(path)
    try:
        status = place.stat()
        if not stat.S_ISFIFO(status.st_mode) or not realpath(place).startswith(OPEN):
            return place
    except (OSError, ValueError):
        return place  # which is refused where it is read
    key = (status.st_dev, status.st_ino)
    if key not in _COPIES:
        folder = _AT_EXIT.enter_context(TemporaryDirectory(prefix="magmatch-"))
        copy, n = Path(folder) / place.name, 0
        with place.open("rb") as source, copy.open("wb") as stream:
            while piece := source.read(PIECE):
                n += stream.write(piece)
                if n > MOST:
                    raise DataFormatError(path, f"more than {MOST} bytes come through this pipe; expected a file")
        _COPIES[key] = copy
    return _COPIES[key]
