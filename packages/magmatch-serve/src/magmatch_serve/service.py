# SPDX-License-Identifier: BSD-3-Clause
"""All that runs between the first and the last request: trackers, workers, the look at the maps, the pictures."""

import asyncio
import json
import logging
from collections.abc import AsyncIterator
from contextlib import AsyncExitStack, asynccontextmanager, suppress
from pathlib import Path
from typing import Any

from magmatch.data.tables.text import is_folder
from magmatch_serve.bodies import checkpoints
from magmatch_serve.bodies.trackers import Trackers
from magmatch_serve.catalogue import Catalogue, Listing, look_at
from magmatch_serve.config import ServeConfig
from magmatch_serve.foxglove_feed import FoxgloveFeed
from magmatch_serve.live import Live
from magmatch_serve.logs.work import picture_of
from magmatch_serve.logs.workers import LogWorkers
from magmatch_serve.metrics import Metrics
from magmatch_serve.refusals import RefusedError

log = logging.getLogger("magmatch.serve")
SWEEP_EVERY = 60.0
# Seconds between two pictures of a map for Foxglove, whose protocol keeps none for those that come later.
MAPS_EVERY = 5.0
MAX_PICTURES = 50


class Service:
    """The state of a service: nothing of it outlives the process but what trackers write."""

    def __init__(self, place: Path, config: ServeConfig) -> None:
        self.place, self.config, self.metrics = place, config, Metrics()
        self.catalogue = Catalogue(place, look_at(place))
        self.connected: dict[str, Live] = {}
        self.n_clients = 0
        self._watchers: set[asyncio.Queue[str]] = set()
        self._pictures: dict[tuple[Listing, str], dict[str, Any]] = {}

    @asynccontextmanager
    async def running(self) -> AsyncIterator[None]:
        """Everything is up for the block."""
        async with AsyncExitStack() as until_end:
            until_end.enter_context(checkpoints.held(self.config.states))
            # First what may not be had, such as a cluster or a port: told before maps are loaded.
            self.workers = LogWorkers(self.config)
            until_end.callback(self.workers.close)
            self.foxglove = None if self.config.foxglove_port is None else FoxgloveFeed(self.config.foxglove_port)
            if self.foxglove is not None:
                until_end.callback(self.foxglove.stop)
            self.trackers = Trackers(self.place, self.config)
            await self.trackers.start()
            until_end.push_async_callback(self.trackers.stop)
            self.metrics.restarts.set_function(lambda: sum(handle.n_restarts for handle in self.trackers.handles))
            self.metrics.maps.set_function(lambda: len(self.catalogue.served.maps))
            self.metrics.fault.set_function(lambda: self.catalogue.fault is not None)
            jobs = {
                self._sweep: SWEEP_EVERY, self._look: self.config.look_every, self._draw: self.config.draw_every,
                self._show_maps: MAPS_EVERY,
            }  # fmt: skip
            tasks = [asyncio.create_task(_again(job, every)) for job, every in jobs.items()]
            try:
                yield
            finally:
                for task in tasks:
                    task.cancel()
                await asyncio.gather(*tasks, return_exceptions=True)

    def enter(self) -> None:
        """Take one of the places for clients."""
        if self.n_clients >= self.config.max_clients:
            raise RefusedError(503, f"{self.n_clients} clients are connected, no more can be", retry_after=30)
        self.n_clients += 1
        self.metrics.clients.set(self.n_clients)

    def leave(self) -> None:
        """Give the place back."""
        self.n_clients -= 1
        self.metrics.clients.set(self.n_clients)

    async def picture(self, name: str) -> dict[str, Any]:
        """A map from above."""
        if name not in self.catalogue.served.names:
            raise RefusedError(404, f"no map is called '{name[:60]}'")
        key = (self.catalogue.served, name)
        if key not in self._pictures:
            made = await self.workers.run_short(picture_of, self.place, *key)
            while len(self._pictures) >= MAX_PICTURES:
                self._pictures.pop(next(iter(self._pictures)))
            self._pictures[key] = made
        return self._pictures[key]

    @asynccontextmanager
    async def watched(self) -> AsyncIterator[asyncio.Queue[str]]:
        """Pictures as they come; whoever is slow sees the latest."""
        queue: asyncio.Queue[str] = asyncio.Queue(1)
        # The first picture has the trails; `_draw` fills the queue only from then on.
        queue.put_nowait(self._snapshot(await self.trackers.watch(with_trail=True)))
        self._watchers.add(queue)
        try:
            yield queue
        finally:
            self._watchers.discard(queue)

    def health(self) -> dict[str, Any]:
        """Whether every tracker answers."""
        up = sum(handle.is_up for handle in self.trackers.handles)
        is_well = up == len(self.trackers.handles)
        return {"status": "well" if is_well else "some trackers start again", "trackers": up}

    def _snapshot(self, bodies: list[dict[str, Any]]) -> str:
        return json.dumps({"type": "bodies", "version": self.catalogue.served.version, "bodies": bodies})

    async def _draw(self) -> None:
        if not (self._watchers or self.foxglove):
            return
        bodies = await self.trackers.watch(with_trail=False)
        if self.foxglove is not None:
            self.foxglove.show(bodies)
        words = self._snapshot(bodies)
        for queue in self._watchers:
            if queue.empty():
                queue.put_nowait(words)

    async def _show_maps(self) -> None:
        """Show Foxglove the maps that bodies are in."""
        if self.foxglove is None:
            return
        names = self.catalogue.served.names
        for frame in {body["map"] for body in await self.trackers.watch(with_trail=False)} - {None}:
            # A body in the only map is told its survey's name.
            name = frame if is_folder(self.place) else names[0]
            if name in names:
                self.foxglove.show_map(frame, await self.picture(name))

    async def _sweep(self) -> None:
        loop = asyncio.get_running_loop()
        await loop.run_in_executor(None, checkpoints.sweep, self.config.states, self.config.keep)

    async def _look(self) -> None:
        loop, before = asyncio.get_running_loop(), self.catalogue.fault
        newer = await loop.run_in_executor(None, self.catalogue.newer)
        if newer is not None:
            log.info("maps have changed: loading them")
            self.catalogue.settle(newer, await self.trackers.renew())
            self.metrics.renewals.inc()
        if self.catalogue.fault not in {None, before}:
            log.warning("the maps as they were are served on: %s", self.catalogue.fault)


async def _again(job: Any, every: float) -> None:
    """Do something every so many seconds, for as long as the service runs."""
    while True:
        with suppress(RefusedError):
            try:
                await job()
            except (OSError, ValueError):
                log.exception("%s", job.__name__)
        await asyncio.sleep(every)
