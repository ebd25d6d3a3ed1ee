# SPDX-License-Identifier: BSD-3-Clause
"""Files as bytes and as lines of text: gzip is read as its content, what is no regular file is refused."""

import errno
import stat
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import BinaryIO

from magmatch.data.tables.gzipped import MAGIC, GzipContent
from magmatch.data.tables.pipes import at_rest
from magmatch.errors import DataFormatError

# Faults of the name that was given; others are faults of the machine.
BAD_NAME = {errno.ENAMETOOLONG, errno.ENOTDIR, errno.ELOOP, errno.EINVAL}
BYTE_ORDER_MARKS = (b"\xff\xfe", b"\xfe\xff")


def is_folder(path: str | Path) -> bool:
    """Whether this is a folder; impossible names are none, and are refused where they are read."""
    try:
        return Path(path).is_dir()
    except (OSError, ValueError):
        return False


def read_bytes(path: str | Path, limit: int = -1) -> bytes:
    """The first `limit` bytes of a regular file (of what it holds, where that is gzip), all by default."""
    with _opened(path) as stream:
        return stream.read(limit)


@contextmanager
def _opened(path: str | Path) -> Iterator[BinaryIO | GzipContent]:
    """A regular file, open for reading; faults of its name in words."""
    if "\0" in str(path):
        raise DataFormatError(path, "holds a NUL character, expected the name of a file")
    try:
        place = at_rest(path)
        mode = place.stat().st_mode
        if not stat.S_ISDIR(mode) and not stat.S_ISREG(mode):
            raise DataFormatError(path, "is not a regular file (a device or socket), expected a file")
        if stat.S_ISDIR(mode):
            raise DataFormatError(path, "is a folder, expected a file")
        with place.open("rb") as stream:
            is_packed = stream.read(len(MAGIC)) == MAGIC
            stream.seek(0)
            yield GzipContent(path, stream) if is_packed else stream
    except FileNotFoundError:
        raise DataFormatError(path, "no such file") from None
    except PermissionError:
        raise DataFormatError(path, "no permission to read it") from None
    except OSError as error:
        if error.errno not in BAD_NAME:
            raise
        raise DataFormatError(path, f"cannot be opened: {error.strerror}") from None


def text_lines(path: str | Path, raw: bytes | None = None) -> list[str]:
    """Lines of a text file without their ends, whichever these are; UTF-8, or UTF-16 with a byte order mark.

    ``raw`` is the content of what is no file of its own (a member of an archive).
    """
    raw = read_bytes(path) if raw is None else raw
    if not raw.strip():
        raise DataFormatError(path, "the file holds only white space" if raw else "the file is empty")
    try:
        text = raw.decode("utf-16" if raw.startswith(BYTE_ORDER_MARKS) else "utf-8-sig")
    except UnicodeDecodeError as error:
        message = (
            f"is not UTF-8 text (byte 0x{raw[error.start]:02x}); save it as UTF-8, or it is not a text file at all"
        )
        raise DataFormatError(path, message, line=raw.count(b"\n", 0, error.start) + 1) from None
    if "\0" in text:
        message = "holds NUL bytes: a binary file, one cut off while writing, or UTF-16 (save it as UTF-8)"
        raise DataFormatError(path, message, line=text.count("\n", 0, text.index("\0")) + 1)
    return text.replace("\r\n", "\n").replace("\r", "\n").split("\n")
