# SPDX-License-Identifier: BSD-3-Clause
"""Gzip files, read as their content."""

import gzip
import tempfile
import zlib
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from pathlib import Path
from typing import BinaryIO

from magmatch.data.tables.pipes import at_rest
from magmatch.errors import DataFormatError

MAGIC = b"\x1f\x8b"
PIECE = 4 << 20


class GzipContent:
    """The content of a gzip file; damage is refused."""

    def __init__(self, path: str | Path, stream: BinaryIO) -> None:
        self.path, self._stream = path, gzip.GzipFile(fileobj=stream)

    def read(self, size: int = -1) -> bytes:
        """The next bytes, as of any file."""
        try:
            return self._stream.read(size)
        except (OSError, EOFError, zlib.error) as error:
            raise DataFormatError(self.path, f"is a damaged gzip file ({error}); cut off while copying?") from None


@contextmanager
def plain_file(path: str | Path) -> Iterator[Path]:
    """The file itself; for a gzip file a passing copy of its content, for readers that need to jump about in it."""
    place = copy = at_rest(path)
    with ExitStack() as held:
        if is_gzip(place):
            folder = held.enter_context(tempfile.TemporaryDirectory(prefix="magmatch-"))
            copy = Path(folder) / (place.stem or "log")
            with place.open("rb") as packed, copy.open("wb") as unpacked:
                content = GzipContent(path, packed)
                while piece := content.read(PIECE):
                    unpacked.write(piece)
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
