# SPDX-License-Identifier: BSD-3-Clause
"""Files as bytes and as lines of text: gzip is read as its content, what is no regular file is refused."""

import errno
import gzip
import shutil
import stat
import tempfile
import zlib
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from pathlib import Path
from typing import BinaryIO, cast

from magmatch.data.tables.pipes import PIECE, at_rest
from magmatch.errors import DataFormatError, MagmatchError

# Faults of the name that was given; others are faults of the machine.
BAD_NAME = {errno.ENAMETOOLONG, errno.ENOTDIR, errno.ELOOP, errno.EINVAL}
BYTE_ORDER_MARKS = (b"\xff\xfe", b"\xfe\xff")
MAGIC = b"\x1f\x8b"  # of gzip


@contextmanager
def damage_told(path: str | Path, kind: str, advice: str = "") -> Iterator[None]:
    """Say in one line what a library finds wrong in a file, and what to do about it."""
    try:
        yield
    except MagmatchError:
        raise
    except Exception as error:  # libraries raise whatever they stumble over
        # A seek to nowhere, and how mcap calls it.
        is_short = type(error).__name__ == "EndOfFile" or getattr(error, "errno", None) == errno.EINVAL
        if isinstance(error, OSError) and error.errno is not None and not is_short:
            raise
        words = "it ends too early" if is_short else " ".join(str(error).split())
        found = printable(words.rstrip(".") or type(error).__name__)
        if "not supported" in found:
            raise DataFormatError(path, f"is a {kind} of a kind that is not read: {found}") from None
        raise DataFormatError(path, f"is a damaged {kind} ({found}){advice}") from None


def printable(text: str) -> str:
    """A text from a file that can be shown: on one line, and not endless."""
    return "".join(c if c.isprintable() else "?" for c in text[:200])


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
def _opened(path: str | Path) -> Iterator[BinaryIO]:
    """A regular file (what it holds, where that is gzip), open for reading; faults of its name in words."""
    if "\0" in str(path):
        raise DataFormatError(path, "holds a NUL character, expected the name of a file")
    try:
        place = at_rest(path)
        mode = place.stat().st_mode
        if not stat.S_ISREG(mode):
            found = "a folder" if stat.S_ISDIR(mode) else "not a regular file (a device or socket)"
            raise DataFormatError(path, f"is {found}, expected a file")
        with place.open("rb") as stream:
            is_packed = stream.read(len(MAGIC)) == MAGIC
            stream.seek(0)
            yield cast("BinaryIO", gzip.GzipFile(fileobj=stream)) if is_packed else stream
    except (gzip.BadGzipFile, EOFError, zlib.error) as error:
        raise DataFormatError(path, f"is a damaged gzip file ({error}); cut off while copying?") from None
    except FileNotFoundError:
        raise DataFormatError(path, "no such file") from None
    except PermissionError:
        raise DataFormatError(path, "no permission to read it") from None
    except OSError as error:
        if error.errno not in BAD_NAME:
            raise
        raise DataFormatError(path, f"cannot be opened: {error.strerror}") from None


@contextmanager
def plain_file(path: str | Path) -> Iterator[Path]:
    """The file itself; for a gzip file a passing copy of its content, for readers that need to jump about in it."""
    place = copy = at_rest(path)
    with ExitStack() as held:
        if is_gzip(place):
            folder = held.enter_context(tempfile.TemporaryDirectory(prefix="magmatch-"))
            copy = Path(folder) / (place.stem or "log")
            with _opened(path) as content, copy.open("wb") as unpacked:
                shutil.copyfileobj(content, unpacked, PIECE)
        try:
            yield copy
        except DataFormatError as error:
            if error.path != copy or copy == Path(path):
                raise
            raise DataFormatError(path, error.message, line=error.line, column=error.column) from None


def is_gzip(path: Path) -> bool:
    """Whether this is a gzip file; what cannot be opened is none, and is refused where it is read."""
    try:
        with at_rest(path).open("rb") as stream:
            return stream.read(len(MAGIC)) == MAGIC
    except (OSError, ValueError):
        return False


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
        message = f"is not UTF-8 text (byte 0x{raw[error.start]:02x}); save it as UTF-8"
        line = raw.count(b"\n", 0, error.start) + 1
        raise DataFormatError(path, f"{message}, or it is not a text file at all", line=line) from None
    if "\0" in text:
        message = "holds NUL bytes: a binary file, one cut off while writing, or UTF-16 (save it as UTF-8)"
        raise DataFormatError(path, message, line=text.count("\n", 0, text.index("\0")) + 1)
    return text.replace("\r\n", "\n").replace("\r", "\n").split("\n")
