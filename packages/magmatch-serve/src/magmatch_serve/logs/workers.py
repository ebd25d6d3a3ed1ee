# SPDX-License-Identifier: BSD-3-Clause
"""Processes that work on whole logs, those of this machine or a Dask cluster's, and draw maps beside them."""

import asyncio
import logging
import multiprocessing
from collections.abc import Callable, Iterator
from concurrent.futures import CancelledError, Executor, Future, ProcessPoolExecutor
from concurrent.futures.process import BrokenProcessPool
from contextlib import contextmanager
from typing import Any

from magmatch.errors import ConfigurationError, import_extra
from magmatch.workers import meet
from magmatch_serve.bodies.trackers import TRACKER
from magmatch_serve.config import ServeConfig
from magmatch_serve.logs.work import begin_worker
from magmatch_serve.refusals import RefusedError, or_raised

log = logging.getLogger("magmatch.serve")
# Seconds within which a cluster's scheduler has to answer.
CONNECT_WITHIN = 5.0


class LogWorkers:
    """Runs functions elsewhere: long ones of logs, of which so many at most come, wait or run, and short ones."""

    def __init__(self, config: ServeConfig) -> None:
        self._config, self._n = config, 0
        self._here = Pool(config)
        self._cluster = None if config.dask is None else Cluster(config, config.dask)
        # Short ones find a process that no log has; where none works on logs here, all are for them.
        self._turns = asyncio.Semaphore(config.log_workers)

    @contextmanager
    def room(self) -> Iterator[None]:
        """Hold one of the places for logs, or refuse the log."""
        if self._n >= self._config.max_logs:
            raise RefusedError(503, f"{self._n} logs come or wait already; try again later", retry_after=30)
        self._n += 1
        try:
            yield
        finally:
            self._n -= 1

    async def run(self, function: Callable[..., Any], *arguments: Any) -> Any:
        """Result of a function of a log; raises it where that is a `RefusedError`."""
        try:
            if self._cluster is not None:
                return or_raised(await self._cluster.run(function, *arguments))
            async with self._turns:
                return or_raised(await self._here.run(function, *arguments))
        except asyncio.CancelledError:  # the server does so, and would answer 500
            raise RefusedError(503, "the service ends; send the log to the next one", retry_after=5) from None

    async def run_short(self, function: Callable[..., Any], *arguments: Any) -> Any:
        """Result of a function that waits for no log."""
        return or_raised(await self._here.run(function, *arguments))

    def close(self) -> None:
        """End all work."""
        self._here.close()
        if self._cluster is not None:
            self._cluster.close()


class Pool:
    """Processes of this machine, each started when it is needed: those for logs, and one more."""

    def __init__(self, config: ServeConfig) -> None:
        self._config = config
        self._executor = self._begin()

    def _begin(self) -> Executor:
        context = multiprocessing.get_context("spawn")
        return ProcessPoolExecutor(self._config.log_workers + 1, context, initializer=begin_worker)

    async def run(self, function: Callable[..., Any], *arguments: Any) -> Any:
        """Result of a function; others take the place of processes that died, and try once more."""
        for _ in range(2):
            executor = self._executor
            try:
                return await asyncio.wrap_future(executor.submit(function, *arguments))
            except (BrokenProcessPool, OSError) as error:  # OSError: it died while it was started
                log.warning("the processes that work on logs begin anew: %s", error)
                if self._executor is executor:
                    self._executor = self._begin()
        raise RefusedError(503, "two processes that worked on this log ended; send it later", retry_after=5)

    def close(self) -> None:
        """End all work."""
        self._executor.shutdown(wait=False, cancel_futures=True)
        for process in multiprocessing.active_children():
            if process.name != TRACKER:
                process.kill()
        self._executor.shutdown()


class Cluster:
    """A Dask cluster; where it loses its scheduler, the next log connects anew."""

    def __init__(self, config: ServeConfig, address: str) -> None:
        self._config, self._address = config, address
        self._distributed: Any = import_extra("distributed", "a Dask cluster", "distributed")
        try:
            self._client = self._connect()
        except (OSError, MemoryError, ValueError) as error:
            log.debug("no cluster: %s", error)
            msg = f"{address}: expected a Dask scheduler there, found none that answers"
            raise ConfigurationError(msg) from None

    def _connect(self) -> Any:
        return self._distributed.Client(meet(self._address), timeout=CONNECT_WITHIN, set_as_default=False)

    async def run(self, function: Callable[..., Any], *arguments: Any) -> Any:
        """Result of a function; what is raised is the cluster's fault, as functions give their own as a result."""
        if self._client.status != "running":
            await self._renew()
        under_way: Future[Any] = Future()
        try:
            async with asyncio.timeout(self._config.max_work_time):
                under_way = self._client.get_executor(pure=False).submit(function, *arguments)
                return await asyncio.wrap_future(under_way)
        except TimeoutError:
            under_way.cancel()
            most = self._config.max_work_time
            raise RefusedError(503, f"no worker was done with this log within {most:g} s", retry_after=30) from None
        except (Exception, asyncio.CancelledError, CancelledError) as error:
            task = asyncio.current_task()
            if task is not None and task.cancelling():
                raise
            log.warning("the cluster lost a log: %s: %s", type(error).__name__, error)
            raise RefusedError(503, "the cluster that works on logs lost this one; send it again", 30) from None

    async def _renew(self) -> None:
        """Connect again, beside all else."""
        loop, old = asyncio.get_running_loop(), self._client
        try:
            client = await loop.run_in_executor(None, self._connect)
        except (OSError, MemoryError):
            raise RefusedError(503, "the cluster that works on logs does not answer", retry_after=30) from None
        # Another log may have been faster.
        self._client, left = (client, old) if self._client is old else (self._client, client)
        await loop.run_in_executor(None, left.close, CONNECT_WITHIN)

    def close(self) -> None:
        """Leave the cluster; what it still works on is forgotten there."""
        self._client.close(CONNECT_WITHIN)
