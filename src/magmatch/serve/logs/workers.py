# SPDX-License-Identifier: BSD-3-Clause
"""Processes that work on whole logs: those of this machine, or a Dask cluster's."""

import asyncio
import multiprocessing
from collections.abc import Callable
from concurrent.futures import Executor, ProcessPoolExecutor
from concurrent.futures.process import BrokenProcessPool
from typing import Any

from magmatch.errors import import_extra
from magmatch.serve.bodies.trackers import TRACKER
from magmatch.serve.config import ServeConfig
from magmatch.serve.logs.work import begin_worker
from magmatch.serve.refusals import RefusedError


class LogWorkers:
    """Runs functions elsewhere; so many at most wait or run."""

    def __init__(self, config: ServeConfig) -> None:
        self._config, self._n = config, 0
        self._client: Any = None
        if config.dask is not None:
            self._client = import_extra("distributed", "a Dask cluster", "distributed").Client(config.dask)
        self._executor = self._begin()

    def _begin(self) -> Executor:
        if self._client is not None:
            executor: Executor = self._client.get_executor(pure=False)
            return executor
        context = multiprocessing.get_context("spawn")
        return ProcessPoolExecutor(self._config.log_workers, context, initializer=begin_worker)

    async def run(self, function: Callable[..., Any], *arguments: Any) -> Any:
        """Result of a function; a `RefusedError` where there is no room, or where that is the result."""
        if self._n >= self._config.max_logs:
            raise RefusedError(503, f"{self._n} logs wait already; try again later", retry_after=30)
        self._n += 1
        executor = self._executor
        try:
            found = await asyncio.wrap_future(executor.submit(function, *arguments))
        except BrokenProcessPool:
            if self._executor is executor:
                self._executor = self._begin()
            raise RefusedError(
                503, "the process that worked on this log ended; send it again", retry_after=5
            ) from None
        finally:
            self._n -= 1
        if isinstance(found, RefusedError):
            raise found
        return found

    def close(self) -> None:
        """End all work."""
        self._executor.shutdown(wait=False, cancel_futures=True)
        for process in multiprocessing.active_children():
            if process.name != TRACKER:
                process.kill()
        self._executor.shutdown()
        if self._client is not None:
            self._client.close()
