# SPDX-License-Identifier: BSD-3-Clause
"""The verb of this room: a map, or a folder of maps, is served until it is told to stop."""

import asyncio
import socket
from collections.abc import Callable
from pathlib import Path

import uvicorn

from magmatch.errors import ConfigurationError
from magmatch.localization.known_map import KnownMap
from magmatch.localization.known_places import open_place
from magmatch.registration.index.atlas import Atlas
from magmatch_serve.app import build_app
from magmatch_serve.config import ServeConfig
from magmatch_serve.connections import Wire, cut_off
from magmatch_serve.service import Service

# Bytes of a request's head.
MAX_HEAD = 16_384
BACKLOG = 512


def serve(place: str | Path, config: ServeConfig, on_start: Callable[[str], None] = lambda _: None) -> None:
    """Serve a map or a folder of maps; ``on_start`` is told the address once every process is ready.

    Raises `DataFormatError` where there is no map, or a damaged one; `ConfigurationError` where the address cannot be
    had.
    """
    listening = _listen(config)
    prepare_once(Path(place))
    service = Service(Path(place).resolve(), config)
    settings = uvicorn.Config(
        build_app(service), http="h11", loop="asyncio", ws=Wire, ws_max_size=config.max_message,
        ws_per_message_deflate=False, h11_max_incomplete_event_size=MAX_HEAD, lifespan="off", log_config=None,
        log_level="error", access_log=False, server_header=False, proxy_headers=False,
        timeout_graceful_shutdown=5, backlog=BACKLOG,
    )  # fmt: skip
    server = _Server(settings, service, lambda: on_start(address_of(listening)))
    with listening:
        server.run(sockets=[listening])


def prepare_once(place: Path) -> None:
    """Prepare maps where they are not yet: otherwise each process would do it again, and so for each log."""
    opened = open_place(place)
    if not isinstance(opened, Atlas):
        KnownMap.of(opened)


class _Server(uvicorn.Server):
    """Begins and ends with the service, whose faults are told by whoever runs this; says when it is ready."""

    def __init__(self, config: uvicorn.Config, service: Service, on_start: Callable[[], None]) -> None:
        super().__init__(config)
        self._running, self._on_start = service.running(), on_start
        self._patience = service.config.patience

    async def startup(self, sockets: list[socket.socket] | None = None) -> None:
        await self._running.__aenter__()
        await super().startup(sockets)
        self._cutting = asyncio.create_task(cut_off(self.server_state.connections, self._patience))
        if self.started:
            self._on_start()

    async def shutdown(self, sockets: list[socket.socket] | None = None) -> None:
        await super().shutdown(sockets)
        self._cutting.cancel()
        await self._running.__aexit__(None, None, None)


def _listen(config: ServeConfig) -> socket.socket:
    """Take the address before any work is done."""
    try:
        kind, *_, address = socket.getaddrinfo(config.host, config.port, type=socket.SOCK_STREAM)[0]
        # Without the protocol's number asyncio leaves small answers to wait for each other (Nagle).
        listening = socket.socket(kind, socket.SOCK_STREAM, socket.IPPROTO_TCP)
        listening.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        listening.bind(address)
    except (OSError, UnicodeError) as error:
        words = getattr(error, "strerror", None) or str(error)
        msg = f"{config.host}, port {config.port}: {words}; say --host or --port"
        raise ConfigurationError(msg) from None
    return listening


def address_of(listening: socket.socket) -> str:
    """Give the address at which it is to be found."""
    host, port = listening.getsockname()[:2]
    return f"http://[{host}]:{port}" if ":" in host else f"http://{host}:{port}"
