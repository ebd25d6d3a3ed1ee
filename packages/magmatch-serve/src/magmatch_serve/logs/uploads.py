# SPDX-License-Identifier: BSD-3-Clause
"""The body of a request on its way to a file of ours: bounded in bytes, as sent and unpacked, and in time."""

import asyncio
import zlib
from collections.abc import Iterator
from pathlib import Path

from starlette.requests import ClientDisconnect, Request

from magmatch_serve.config import ServeConfig
from magmatch_serve.refusals import RefusedError

PIECE = 1 << 20


async def receive_log(request: Request, path: Path, config: ServeConfig) -> None:
    """Write the body of a request to a file."""
    length = request.headers.get("content-length")
    if length is not None and (not length.isdecimal() or int(length) > config.max_body):
        raise _too_long(config.max_body)
    coding = request.headers.get("content-encoding", "identity").strip().lower()
    if coding not in {"identity", "gzip"}:
        raise RefusedError(415, "Content-Encoding: expected gzip or none")
    if request.headers.get("content-type", "").startswith("multipart/"):
        raise RefusedError(
            415, "expected the log itself as the body, found a multipart form (curl: --data-binary @LOG)"
        )
    try:
        async with asyncio.timeout(config.max_upload_time):
            await _receive(request, path, config, zlib.decompressobj(31) if coding == "gzip" else None)
    except TimeoutError:
        raise RefusedError(408, f"expected the log within {config.max_upload_time:g} s") from None
    except ClientDisconnect:
        raise RefusedError(400, "the log was cut off") from None


async def _receive(request: Request, path: Path, config: ServeConfig, unpacking: "zlib._Decompress | None") -> None:
    n_sent = n_unpacked = 0
    with path.open("wb") as stream:
        async for piece in request.stream():
            n_sent += len(piece)
            if n_sent > config.max_body:
                raise _too_long(config.max_body)
            if unpacking is None:
                stream.write(piece)
                continue
            for plain in _unpacked(unpacking, piece):
                n_unpacked += len(plain)
                if n_unpacked > config.max_unpacked:
                    raise RefusedError(413, f"unpacks to more than {config.max_unpacked} bytes")
                stream.write(plain)
        if unpacking is not None and not unpacking.eof:
            raise RefusedError(400, "Content-Encoding: the gzip body is cut off")
    if n_sent == 0:
        raise RefusedError(400, "expected a log as the body, found nothing")


def _unpacked(unpacking: "zlib._Decompress", packed: bytes) -> Iterator[bytes]:
    """Unpack a piece, in pieces."""
    while packed:
        try:
            yield unpacking.decompress(packed, PIECE)
        except zlib.error:
            raise RefusedError(400, "Content-Encoding: the body is not gzip") from None
        packed = unpacking.unconsumed_tail


def _too_long(most: int) -> RefusedError:
    return RefusedError(413, f"the body is longer than {most} bytes")
