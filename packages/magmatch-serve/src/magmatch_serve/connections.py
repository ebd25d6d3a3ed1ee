# SPDX-License-Identifier: BSD-3-Clause
"""Connections to the service: WebSockets that one client cannot fill, and an end to those that only take room."""

import asyncio
from collections.abc import Collection
from typing import Any

from uvicorn.protocols.http.h11_impl import H11Protocol
from uvicorn.protocols.websockets.websockets_sansio_impl import WebSocketsSansIOProtocol

# Bytes that are read of a WebSocket at once: of one that floods, so much is parsed before others have their turn.
MAX_READ = 8192


class Wire(WebSocketsSansIOProtocol):
    """Reads little at a time; asyncio's transports would read 256 KiB, thousands of samples."""

    def connection_made(self, transport: asyncio.Transport) -> None:  # type: ignore[override]
        """Begin to read, little at a time."""
        transport.max_size = MAX_READ  # type: ignore[attr-defined]
        super().connection_made(transport)

    async def send(self, message: Any) -> None:
        """A refusal is an answer, too: uvicorn would log an error and send 500 after it."""
        await super().send(message)
        self.handshake_complete = self.handshake_complete or self.close_sent

    def handle_ping(self) -> None:
        """Answer; for one that does not read, answers would fill the memory."""
        if self.writable.is_set():
            super().handle_ping()
        else:
            self.conn.data_to_send()


async def cut_off(connections: Collection[Any], patience: float) -> None:
    """Look every so many s, and cut off what has waited for the same thing since the last look.

    To time each request and answer would cost as much as to send it.
    """
    before: dict[Any, Any] = {}
    while True:
        await asyncio.sleep(patience)
        now = {one: _awaited(one) for one in connections}
        for one, what in now.items():
            if what is not None and before.get(one) == what:
                one.transport.abort()
        before = now


def _awaited(one: Any) -> Any:
    """Say what a connection waits for: a further request, or that bytes are taken; None where it does not."""
    is_http, unsent = isinstance(one, H11Protocol), one.transport.get_write_buffer_size()
    is_full = one.flow.write_paused if is_http else not one.writable.is_set()
    if unsent and (is_full or one.transport.is_closing()):
        return unsent
    if is_http and (one.cycle is None or one.cycle.response_complete):
        return "request", one.cycle
    return None
