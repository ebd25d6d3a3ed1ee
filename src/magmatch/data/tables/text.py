# SPDX-License-Identifier: BSD-3-Clause
"""Files as bytes and as lines of text: gzip is read as its content, what is no regular file is refused."""

import errno
import stat
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import BinaryIO

from magmatch.data.tables.gzipped import MAGIC, GzipContent
from magmatch.data.tables.pipes import at_rest
from magmatch.errors import DataFormatError

# Faults of the name that was given; others are faults of the machine.
BAD_NAME = {errno.ENAMETOOLONG, errno.ENOTDIR, errno.ELOOP, errno.EINVAL}
# Bytes of text turned into lines at a time, and of one line; stated in docs/formats.md.
BLOCK, MAX_LINE = 4 << 20, 16 << 20
BYTE_ORDER_MARKS = (b"\xff\xfe", b"\xfe\xff")


@dataclass(frozen=True, slots=True)
class Block:
    """Consecutive lines of a text file, without their ends: `start` lines stand before them."""

    start: int
    lines: list[str]
    is_last: bool


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
    place = at_rest(path)
    try:
        mode = place.stat().st_mode
        if not stat.S_ISDIR(mode) and not stat.S_ISREG(mode):
            raise DataFormatError(path, "is not a regular file (a device, pipe or socket), expected a file")
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


def text_lines(path: str | Path, raw: bytes) -> list[str]:
    """Lines of a text file without their ends, whichever these are; UTF-8, or UTF-16 with a byte order mark."""
    return next(text_blocks(path, raw)).lines


def text_blocks(path: str | Path, raw: bytes | None = None) -> Iterator[Block]:
    """Give the lines of a text file in blocks of some megabytes, so that a long one is never held as a whole."""
    start, is_blank, n_bytes = 0, True, 0
    for piece, is_last in _pieces(path) if raw is None else [(raw, True)]:
        is_blank, n_bytes = is_blank and not piece.strip(), n_bytes + len(piece)
        if is_last and is_blank:
            raise DataFormatError(path, "the file is empty" if not n_bytes else "the file holds only white space")
        lines = _lines(path, piece, start)
        if not is_last:
            lines.pop()  # the nothing behind the last line end
        yield Block(start, lines, is_last)
        start += len(lines)


def _pieces(path: str | Path) -> Iterator[tuple[bytes, bool]]:
    """Content of a file, cut behind line ends; and whether it is the last piece."""
    held = b""
    with _opened(path) as stream:
        while more := stream.read(BLOCK):
            held += more
            if held.startswith(BYTE_ORDER_MARKS):
                held += stream.read()
                break
            cut = held.rfind(b"\n") + 1 or held.rfind(b"\r", 0, -1) + 1
            if cut:
                yield held[:cut], False
                held = held[cut:]
            elif len(held) > MAX_LINE:
                raise DataFormatError(path, f"holds a line of more than {MAX_LINE} bytes: no table of samples")
    yield held, True


def _lines(path: str | Path, raw: bytes, start: int) -> list[str]:
    """Lines of a part of a text file behind so many others."""
    try:
        encoding = "utf-8" if start else "utf-16" if raw.startswith(BYTE_ORDER_MARKS) else "utf-8-sig"
        text = raw.decode(encoding)
    except UnicodeDecodeError as error:
        line = start + raw.count(b"\n", 0, error.start) + 1
        message = (
            f"is not UTF-8 text (byte 0x{raw[error.start]:02x}); save it as UTF-8, or it is not a text file at all"
        )
        raise DataFormatError(path, message, line=line) from None
    if "\0" in text:
        line = start + text.count("\n", 0, text.index("\0")) + 1
        raise DataFormatError(
            path, "holds NUL bytes: a binary file, one cut off while writing, or UTF-16 (save it as UTF-8)", line=line
        )
    return text.replace("\r\n", "\n").replace("\r", "\n").split("\n")
