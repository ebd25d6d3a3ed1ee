# SPDX-License-Identifier: BSD-3-Clause
"""One client's connection: it says who it is, then samples go in and poses come out, one answer a message."""

import asyncio
from collections import deque
from time import monotonic
from typing import Any

from starlette.websockets import WebSocket, WebSocketDisconnect

from magmatch_serve.allowance import Allowance
from magmatch_serve.bodies.trackers import TrackerHandle
from magmatch_serve.config import ServeConfig
from magmatch_serve.keys import id_of, is_key, new_key
from magmatch_serve.messages import SAMPLE, Hello, read_hello
from magmatch_serve.metrics import Metrics
from magmatch_serve.refusals import CLOSE_WITH, RefusedError, or_raised

PROTOCOL = "magmatch.1"
ASK_AGAIN = 0.05  # seconds until a client's maps may be ready
MAX_REASON = 120  # bytes that a closing WebSocket may say


class Live:
    """A client from its hello to its leave.

    Messages of one client are answered in order. No more than `max_under_way` are on their way at once, and samples
    that come faster than `max_rate` wait: a client that floods, or does not read, waits for itself alone.
    """

    def __init__(self, socket: WebSocket, config: ServeConfig, metrics: Metrics) -> None:
        self._socket, self._config, self._metrics = socket, config, metrics
        self._samples = Allowance(config.max_rate, 2 * config.max_rate)
        self._mistakes = Allowance(1.0, config.max_mistakes)
        self._outbox: asyncio.Queue[str | bytes | RefusedError] = asyncio.Queue()
        self._came: deque[float] = deque()
        self._room = asyncio.Semaphore(config.max_under_way)
        # Why it is sent away.
        self._end: asyncio.Future[RefusedError] = asyncio.get_running_loop().create_future()
        self._is_replaced = False
        self.client, self.key = "", ""

    async def hello(self) -> Hello:
        """Wait for the first message."""
        try:
            async with asyncio.timeout(self._config.patience):
                message = await self._socket.receive()
        except TimeoutError:
            raise RefusedError(408, f"expected a hello within {self._config.patience:g} s") from None
        if message["type"] == "websocket.disconnect":
            raise WebSocketDisconnect(message.get("code", 1006))
        if not (text := message.get("text")):
            raise RefusedError(400, 'expected {"type": "hello"} as the first message, found a binary one')
        said = read_hello(text)
        if said.key is not None and not is_key(said.key):
            raise RefusedError(422, "key: expected that of an earlier welcome, 43 characters")
        self.key = said.key or new_key()
        self.client = id_of(self.key)
        return said

    async def follow(self, tracker: TrackerHandle, said: Hello) -> None:
        """Answer until the client leaves."""
        introduced = ("open", self.client, said.name, said.answers == "binary", said.anew)
        while (opened := await tracker.asked(*introduced)) is None:
            await asyncio.sleep(ASK_AGAIN)
        await self._socket.send_json({"type": "welcome", "client": self.client, "key": self.key, **opened})
        tracker.on_death.add(self._tracker_died)
        tasks: list[asyncio.Future[Any]] = [
            asyncio.create_task(self._write()),
            asyncio.create_task(self._read(tracker)),
        ]
        try:
            done, _ = await asyncio.wait([*tasks, self._end], return_when=asyncio.FIRST_COMPLETED)
            for one in done:
                or_raised(one.result())
        finally:
            self._end.cancel()
            tracker.on_death.discard(self._tracker_died)
            for task in tasks:
                task.cancel()
            await asyncio.gather(*tasks, return_exceptions=True)
            if not self._is_replaced:
                tracker.ask(lambda _: None, "leave", self.client)

    def replace(self) -> None:
        """Make room for another connection with the same key."""
        self._is_replaced = True
        self._send_away(RefusedError(409, "the same key came with another connection, which goes on instead"))

    def _tracker_died(self) -> None:
        self._send_away(RefusedError(503, "the process that follows this client ended; come again with its key"))

    def _send_away(self, why: RefusedError) -> None:
        if not self._end.done():
            self._end.set_result(why)

    async def _read(self, tracker: TrackerHandle) -> None:
        receive = self._socket.receive
        while True:
            await self._room.acquire()
            message = await receive()
            if message["type"] == "websocket.disconnect":
                return
            data = message.get("text")
            if data is None:
                data = message["bytes"]
            now = monotonic()
            # A JSON message of many samples is longer than that many binary ones.
            wait = self._samples.take(max(1.0, len(data) / (SAMPLE.itemsize if isinstance(data, bytes) else 200)))
            self._came.append(now)
            tracker.ask(self._on_answer, "take", self.client, data)
            if wait > 0:
                await asyncio.sleep(wait)

    def _on_answer(self, answer: str | bytes | RefusedError) -> None:
        """Hand on an answer of the tracker."""
        if self._end.done():
            return
        if isinstance(answer, RefusedError) and self._mistakes.take() > 0:
            self._send_away(RefusedError(429, f"more than {self._config.max_mistakes} messages could not be read"))
            return
        self._outbox.put_nowait(answer)

    async def _write(self) -> None:
        """Send answers."""
        socket, came = self._socket, self._came
        while True:
            answer = await self._outbox.get()
            if isinstance(answer, RefusedError):
                self._metrics.refused.labels(answer.status).inc()
                await socket.send_json(answer.document)
            elif isinstance(answer, bytes):
                await socket.send_bytes(answer)
            else:
                await socket.send_text(answer)
            if came:
                self._metrics.wait.observe(monotonic() - came.popleft())
                self._metrics.messages.inc()
            self._room.release()


async def close(socket: WebSocket, why: RefusedError) -> None:
    """Say why, and close."""
    reason = why.message.encode()[:MAX_REASON].decode(errors="ignore")
    try:
        async with asyncio.timeout(1.0):
            await socket.close(CLOSE_WITH + why.status, reason)
    except (TimeoutError, RuntimeError, WebSocketDisconnect):
        pass
