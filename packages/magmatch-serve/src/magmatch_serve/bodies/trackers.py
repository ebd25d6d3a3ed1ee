# SPDX-License-Identifier: BSD-3-Clause
"""All trackers, seen from the service: who follows whom, messages sent in batches, and what happens if one dies."""

import asyncio
import logging
import multiprocessing
from collections import deque
from collections.abc import Callable
from itertools import chain, repeat
from multiprocessing.context import SpawnProcess
from pathlib import Path
from time import monotonic
from typing import Any

from magmatch.errors import TaskError
from magmatch_serve.bodies.tracker import run_tracker
from magmatch_serve.config import ServeConfig
from magmatch_serve.refusals import RefusedError, or_raised

log = logging.getLogger("magmatch.serve")
# Requests that go to a tracker at once: what it does in a few ms.
MAX_BATCH = 64
# Seconds between two batches: of many clients at once, each wakes two processes; one client alone never waits.
GATHER = 0.004
# Deaths within so many seconds after which a tracker is not started again.
MOST_DEATHS, DEATHS_WITHIN = 10, 60.0
STOP_WITHIN = 20.0
TRACKER = "magmatch tracker"
PAUSES = (1.0, 2.0, 5.0, 10.0, 30.0, 60.0)
Answer = Callable[[Any], None]


class TrackerHandle:
    """One tracker: it is sent a batch, and the next once that is answered, so that no pipe ever fills."""

    def __init__(self, place: Path, config: ServeConfig) -> None:
        self._place, self._config = place, config
        self._waiting: deque[tuple[tuple[Any, ...], Answer]] = deque()
        self._under_way: list[Answer] = []
        self._loop = asyncio.get_running_loop()
        self._deaths: deque[float] = deque(maxlen=MOST_DEATHS)
        self._process: SpawnProcess | None = None
        self._starting: asyncio.Task[None] | None = None
        self._is_closing = self.is_up = self._is_due = False
        self._sent_at = 0.0
        self.n_restarts = 0
        # Called when the process is dead: whoever it followed comes again, to go on from the last checkpoint.
        self.on_death: set[Callable[[], None]] = set()

    async def start(self) -> None:
        """Start the process and wait until its maps are loaded."""
        context = multiprocessing.get_context("spawn")
        self._pipe, theirs = context.Pipe()
        arguments = (theirs, self._place, self._config)
        self._process = context.Process(target=run_tracker, args=arguments, name=TRACKER, daemon=True)
        self._process.start()
        theirs.close()
        try:
            fault = await self._loop.run_in_executor(None, self._pipe.recv)
        except (EOFError, OSError):
            msg = "a process that follows clients ended before it was ready"
            raise TaskError(msg) from None
        if fault is not None:
            raise fault
        self.is_up = True
        self._loop.add_reader(self._pipe.fileno(), self._on_readable)

    def ask(self, answer: Answer, verb: str, *arguments: Any) -> None:
        """Send a request; its answer, or a `RefusedError`, is given to a function."""
        if self._is_closing or not self.is_up:
            answer(RefusedError(503, "the process that follows this client starts again; come again", retry_after=5))
            return
        self._waiting.append(((verb, *arguments), answer))
        self._plan()

    async def asked(self, verb: str, *arguments: Any) -> Any:
        """Send a request and wait for the answer."""
        future: asyncio.Future[Any] = self._loop.create_future()
        self.ask(lambda found: None if future.done() else future.set_result(found), verb, *arguments)
        return or_raised(await future)

    async def stop(self) -> None:
        """Let the process write what it knows and end."""
        self._is_closing = True
        if self._starting is not None:
            self._starting.cancel()
        if self._process is None:
            return
        if self.is_up:
            self._loop.remove_reader(self._pipe.fileno())
            self.is_up = False
        try:
            await self._loop.run_in_executor(None, self._pipe.send, None)
            await self._loop.run_in_executor(None, self._process.join, STOP_WITHIN)
        except OSError:
            pass
        if self._process.is_alive():
            self._process.kill()
            self._process.join()
        self._pipe.close()

    def _plan(self) -> None:
        """Send what waits, after all that can be read now has been."""
        if self._waiting and not self._under_way and not self._is_due:
            self._is_due = True
            self._loop.call_at(self._sent_at + GATHER, self._flush)

    def _flush(self) -> None:
        self._is_due = False
        if self._under_way or not self._waiting or not self.is_up:
            return
        batch = [self._waiting.popleft() for _ in range(min(MAX_BATCH, len(self._waiting)))]
        self._under_way, self._sent_at = [answer for _, answer in batch], self._loop.time()
        try:
            self._pipe.send([(k, *request) for k, (request, _) in enumerate(batch)])
        except OSError:
            self._on_death()

    def _on_readable(self) -> None:
        try:
            answers = self._pipe.recv()
        except (EOFError, OSError):
            self._on_death()
            return
        asked, self._under_way = self._under_way, []
        for number, found in answers:
            asked[number](found)
        self._plan()

    def _on_death(self) -> None:
        """Tell those whose requests are lost, and start another process."""
        self._loop.remove_reader(self._pipe.fileno())
        self._pipe.close()
        self.is_up = False
        lost, self._under_way = [*self._under_way, *(answer for _, answer in self._waiting)], []
        self._waiting.clear()
        now = monotonic()
        is_hopeless = len(self._deaths) == MOST_DEATHS and now - self._deaths[0] < DEATHS_WITHIN
        self._deaths.append(now)
        if not (self._is_closing or is_hopeless):
            log.warning("a process that follows clients ended; another takes its place")
            self._starting = self._loop.create_task(self._revive())
        for tell in list(self.on_death):
            tell()
        for answer in lost:
            answer(RefusedError(503, "the process that follows this client ended; come again", retry_after=5))

    async def _revive(self) -> None:
        if self._process is not None:
            await self._loop.run_in_executor(None, self._process.join, STOP_WITHIN)
        self.n_restarts += 1
        for pause in chain(PAUSES, repeat(PAUSES[-1])):  # maps may be half replaced, or gone for hours
            try:
                await self.start()
                break
            except Exception as error:
                log.warning("no other process could be started: %s", error)
                await asyncio.sleep(pause)
        self._starting = None


class Trackers:
    """Each client's tracker follows from its id, so that a client that comes back finds its body in memory."""

    def __init__(self, place: Path, config: ServeConfig) -> None:
        self.handles = [TrackerHandle(place, config) for _ in range(config.trackers)]

    async def start(self) -> None:
        """Start all; the first fault is raised."""
        results = await asyncio.gather(*(handle.start() for handle in self.handles), return_exceptions=True)
        for fault in results:
            if isinstance(fault, BaseException):
                await self.stop()
                raise fault

    def of(self, client: str) -> TrackerHandle:
        """Give the tracker that follows a client."""
        return self.handles[int(client, 16) % len(self.handles)]

    async def watch(self, *, with_trail: bool) -> list[dict[str, Any]]:
        """Tell what is drawn of each body."""
        try:
            found = await asyncio.gather(*(h.asked("watch", with_trail) for h in self.handles if h.is_up))
        except RefusedError:
            return []
        return [one for part in found for one in part]

    async def renew(self) -> list[str]:
        """Load the maps again in all; what is wrong with them, if anything."""
        await asyncio.gather(*(handle.asked("renew") for handle in self.handles))
        faults = []
        for handle in self.handles:
            while not (found := await handle.asked("renewed")):
                await asyncio.sleep(0.2)
            faults += [] if found is True else [found]
        return faults

    async def stop(self) -> None:
        """Stop all."""
        await asyncio.gather(*(handle.stop() for handle in self.handles))
