# SPDX-License-Identifier: BSD-3-Clause
"""A log's bytes: nothing is read, or made room for, that the file does not hold."""

from collections.abc import Callable
from pathlib import Path
from types import TracebackType

from magmatch.errors import DataFormatError, MissingExtraError

# Bounds, stated in docs/formats.md. Recorders write chunks of some MB; one image may make a larger one.
MAX_CHUNK = 256 << 20  # bytes of one chunk once decompressed
MAX_RECORD = 16 << 20  # bytes of one record that is not a chunk and is read whole
MAX_RATIO = 200  # bytes decompressed over bytes of the file, all chunks together, beyond one MAX_CHUNK


class DamagedError(Exception):
    """A piece of a log is not whole; caught by the log that owns the piece, never seen outside.

    Parameters
    ----------
    position : int
        Byte of the file where the piece begins.
    words : str
        What is wrong with it.
    """

    def __init__(self, position: int, words: str) -> None:
        super().__init__(words)
        self.position, self.words = position, words


class Source:
    """A regular file, read piece by piece.

    Parameters
    ----------
    path : path
        The file, already known to be a regular one.
    """

    def __init__(self, path: str | Path) -> None:
        self.path = Path(path)
        self._stream = self.path.open("rb")
        self.size = self._stream.seek(0, 2)
        self._n_decompressed = 0

    def __enter__(self) -> "Source":
        return self

    def __exit__(
        self, _kind: type[BaseException] | None, _error: BaseException | None, _trace: TracebackType | None
    ) -> None:
        self._stream.close()

    def read(self, position: int, n: int) -> bytes:
        """Bytes from a position; DamagedError where the file ends before."""
        if position + n > self.size:
            raise DamagedError(position, f"the file ends at byte {self.size}, {position + n - self.size} too early")
        self._stream.seek(position)
        return self._stream.read(n)

    def read_available(self, position: int, n: int) -> bytes:
        """Bytes from a position, as many as there are."""
        return self.read(position, max(0, min(n, self.size - position)))

    def expand(self, position: int, compression: str, raw: bytes, size: int, *, is_cut: bool = False) -> bytes:
        """Decompress a chunk, to no more than it says and no more than the bounds allow.

        Parameters
        ----------
        position : int
            Where the chunk begins, for messages.
        compression : str
            "none", "bz2", "lz4" or "zstd".
        raw : bytes
            What the file holds of it.
        size : int
            Length it declares for its content.
        is_cut : bool
            Whether the end of `raw` is missing; then whatever comes out is given.

        Returns
        -------
        bytes
        """
        if size > MAX_CHUNK:
            raise DamagedError(position, f"a chunk declares {size} bytes, more than the {MAX_CHUNK} allowed")
        decompress = _DECOMPRESSORS.get(compression)
        if decompress is None:
            raise DataFormatError(self.path, f"is compressed with {compression[:20]!r}, expected bz2, lz4 or zstd")
        content = decompress(position, raw, size)
        if len(content) > size or (len(content) < size and not is_cut):
            raise DamagedError(position, f"a chunk declares {size} bytes but holds {_count(len(content), size)}")
        self._n_decompressed += 0 if compression == "none" else len(content)
        if self._n_decompressed > MAX_CHUNK + MAX_RATIO * self.size:
            message = f"decompresses to more than {MAX_RATIO} times its size: no log does, refused as a zip bomb"
            raise DataFormatError(self.path, message)
        return content


def _count(found: int, size: int) -> str:
    return f"{found}" if found <= size else "more"


def _stored(_position: int, raw: bytes, _size: int) -> bytes:
    return raw


def _bunzip(position: int, raw: bytes, size: int) -> bytes:
    import bz2

    try:
        return bz2.BZ2Decompressor().decompress(raw, size + 1)
    except (OSError, ValueError, EOFError) as error:
        raise DamagedError(position, f"a bz2 chunk is damaged ({error})") from None


def _unlz4(position: int, raw: bytes, size: int) -> bytes:
    try:
        import lz4.frame
    except ImportError:
        feature = "reading a log with lz4 chunks"
        raise MissingExtraError(feature, "ros") from None
    try:
        content: bytes = lz4.frame.LZ4FrameDecompressor().decompress(raw, size + 1)
    except (RuntimeError, EOFError, ValueError, MemoryError) as error:
        raise DamagedError(position, f"an lz4 chunk is damaged ({error})") from None
    return content


def _unzstd(position: int, raw: bytes, size: int) -> bytes:
    try:
        import zstandard
    except ImportError:
        feature = "reading a log with zstd chunks"
        raise MissingExtraError(feature, "ros") from None
    try:
        decompressor = zstandard.ZstdDecompressor(max_window_size=MAX_CHUNK)
        return decompressor.stream_reader(raw, read_across_frames=True).read(size + 1)
    except (zstandard.ZstdError, ValueError, MemoryError) as error:
        raise DamagedError(position, f"a zstd chunk is damaged ({error})") from None


_DECOMPRESSORS: dict[str, Callable[[int, bytes, int], bytes]] = {
    "none": _stored,
    "bz2": _bunzip,
    "lz4": _unlz4,
    "zstd": _unzstd,
}
