# SPDX-License-Identifier: BSD-3-Clause
"""Write a file whole or not at all: an interrupted run never leaves half a survey behind."""

import os
import secrets
from collections.abc import Iterable
from pathlib import Path

from magmatch.errors import DataFormatError


def write_atomically(path: str | Path, chunks: Iterable[bytes]) -> None:
    """Write bytes to a temporary file in the same folder, flush them to the disk, then rename.

    A link is followed, and a device or pipe (such as ``/dev/stdout``) is written straight through, since renaming
    over it would remove it.

    Parameters
    ----------
    path : path
        Where the file shall be; an existing file is replaced.
    chunks : iterable of bytes
        The content, in order.

    Raises
    ------
    DataFormatError
        The folder does not exist, or the path is itself a folder.
    OSError
        The machine cannot write (disk full, no permission); nothing is left behind.
    """
    goal = Path(path).resolve()
    if goal.is_dir():
        raise DataFormatError(path, "is a folder, expected the name of a file to write")
    if not goal.parent.is_dir():
        raise DataFormatError(path, f"the folder {goal.parent} does not exist; create it first")
    if goal.exists() and not goal.is_file():
        with goal.open("wb") as stream:
            stream.writelines(chunks)
        return
    temporary = goal.with_name(f".{goal.name}.{secrets.token_hex(4)}.tmp")
    try:
        with temporary.open("xb") as stream:
            stream.writelines(chunks)
            stream.flush()
            os.fsync(stream.fileno())
        temporary.replace(goal)
    except BaseException:
        temporary.unlink(missing_ok=True)
        raise
