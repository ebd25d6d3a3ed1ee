# SPDX-License-Identifier: BSD-3-Clause
"""Decompression that a file cannot turn into a bomb.

Ours, because rosbags and mcap decompress a chunk to whatever length it has, and give nothing of one that is cut off.
"""

import bz2
from pathlib import Path

import lz4.frame
import zstandard

from magmatch.errors import DataFormatError

# Bounds, stated in docs/formats.md. Recorders write chunks of some MB; one image may make a larger one.
MAX_CHUNK = 256 << 20  # bytes of one chunk once decompressed
MAX_RATIO = 200  # bytes decompressed over bytes compressed, all chunks together, beyond one MAX_CHUNK
_FAULTS = (OSError, RuntimeError, EOFError, ValueError, MemoryError, zstandard.ZstdError)


class DamagedError(Exception):
    """A piece of a log is not whole: a byte of the file or chunk, or the id of a record, and what is wrong there."""

    def __init__(self, place: int, words: str) -> None:
        super().__init__(words)
        self.place = place


class Decompressor:
    """Decompresses the chunks of one file, within its bounds."""

    def __init__(self, path: Path) -> None:
        self._path, self._left = path, MAX_CHUNK

    def expand(self, compression: str, raw: bytes, size: int | None = None, place: int = 0) -> bytes:
        """Content of a chunk, or of as much of one as there is; DamagedError beyond `size` bytes."""
        size = MAX_CHUNK if size is None else size
        if max(size, len(raw)) > MAX_CHUNK:
            raise DamagedError(place, f"a chunk of {max(size, len(raw))} bytes, more than the {MAX_CHUNK} allowed")
        try:
            if compression == "bz2":
                content = bz2.BZ2Decompressor().decompress(raw, size + 1)
            elif compression == "lz4":
                content = lz4.frame.LZ4FrameDecompressor().decompress(raw, size + 1)
            elif compression == "zstd":
                reader = zstandard.ZstdDecompressor(max_window_size=MAX_CHUNK).stream_reader
                content = reader(raw, read_across_frames=True).read(size + 1)
            elif compression in {"", "none"}:
                content = raw
            else:
                message = f"is compressed with {compression[:20]!r}, expected bz2, lz4 or zstd"
                raise DataFormatError(self._path, message)
        except _FAULTS as error:
            if isinstance(error, DataFormatError):
                raise
            raise DamagedError(place, f"a chunk of {compression} is damaged ({error})") from None
        if content is not raw:
            self._left += MAX_RATIO * len(raw) - len(content)
        if self._left < 0:
            message = f"decompresses to more than {MAX_RATIO} times its size: no log does, refused as a zip bomb"
            raise DataFormatError(self._path, message)
        if len(content) > size:
            raise DamagedError(place, f"a chunk of {size} bytes holds more")
        return content
