# SPDX-License-Identifier: BSD-3-Clause
"""Atomic writing of files: an interrupted run leaves either the old file or the new one."""

import errno
import os
import secrets
import stat
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from io import BytesIO
from pathlib import Path
from typing import BinaryIO

from magmatch.errors import DataFormatError

# What file systems answer that cannot flush a folder; the rename itself has already happened by then.
CANNOT_FLUSH_FOLDERS = {errno.EINVAL, errno.ENOTSUP, errno.EACCES, errno.EBADF}


def real_path(path: str | Path) -> Path:
    """Follow the links of a path to their end; links that lead in a circle are refused, and what is no path."""
    if not isinstance(path, str | os.PathLike):
        from magmatch.arguments import expect_path  # its numerics are not waited for

        expect_path(path)
    place = Path(os.path.realpath(path))
    if place.is_symlink():
        raise DataFormatError(path, "is a link that leads back to itself, expected a file")
    return place


@contextmanager
def atomic_write(path: str | Path) -> Iterator[BinaryIO]:
    """Open a file for writing that appears under its name only once it is whole and on the disk.

    The content goes to ``.NAME.tmp-...`` in the same folder, is flushed, and then takes the place of the old file
    in one step. A link is followed, and a device or pipe (such as ``/dev/stdout``) is written straight through,
    since renaming over it would remove it. An exception inside the block leaves the old file as it was.

    Examples
    --------
    >>> from tempfile import TemporaryDirectory
    >>> with TemporaryDirectory() as folder:
    ...     with atomic_write(Path(folder) / "note.txt") as stream:
    ...         _ = stream.write(b"whole")
    ...     (Path(folder) / "note.txt").read_bytes()
    b'whole'
    """
    goal = real_path(path)
    if goal.is_dir():
        raise DataFormatError(path, "is a folder, expected the name of a file to write")
    # Asked of the name as given: a pipe behind /dev/stdout resolves to a name that no folder holds.
    if Path(path).exists() and not goal.is_file():
        buffer = BytesIO()
        yield buffer
        with _naming(path):
            Path(path).write_bytes(buffer.getvalue())
        return
    if not goal.parent.is_dir():
        raise DataFormatError(path, f"the folder {goal.parent} does not exist; create it first")
    # Cut short, so that a name of the longest length allowed leaves room for what is added to it.
    temporary = goal.with_name(f".{goal.name[:50]}.tmp-{secrets.token_hex(4)}")
    try:
        with _naming(path, temporary):
            with temporary.open("xb") as stream:
                yield stream
                stream.flush()
                os.fsync(stream.fileno())
            if goal.exists():
                temporary.chmod(stat.S_IMODE(goal.stat().st_mode))
            temporary.replace(goal)
            _flush_folder(goal.parent)
    finally:
        with suppress(OSError):  # a read-only disk refuses this too
            temporary.unlink()


def write_whole(path: str | Path, content: bytes) -> None:
    """Write content that is all there to a file as `atomic_write` does."""
    with atomic_write(path) as stream:
        stream.write(content)


@contextmanager
def _naming(path: str | Path, temporary: Path | None = None) -> Iterator[None]:
    """Name the file in errors of the operating system, which reports a full disk without a name."""
    try:
        yield
    except OSError as error:
        if error.errno is None or error.filename not in (None, str(temporary)):
            raise
        raise OSError(error.errno, error.strerror, str(path)) from error


def _flush_folder(folder: Path) -> None:
    """Make a rename survive a power cut, where the system can."""
    if os.name != "posix":
        return
    try:
        handle = os.open(folder, os.O_RDONLY)
    except PermissionError:  # a folder that can be written but not listed
        return
    try:
        os.fsync(handle)
    except OSError as error:
        if error.errno not in CANNOT_FLUSH_FOLDERS:
            raise
    finally:
        os.close(handle)
