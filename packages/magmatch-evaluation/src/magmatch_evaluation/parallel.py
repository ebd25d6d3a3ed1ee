# SPDX-License-Identifier: BSD-3-Clause
"""Who does the work: this process, others on this machine, or the workers of a Dask scheduler."""

import multiprocessing
from collections.abc import Callable, Iterable, Iterator
from concurrent.futures import FIRST_COMPLETED, Executor, Future, ProcessPoolExecutor, wait
from concurrent.futures.process import BrokenProcessPool
from contextlib import contextmanager
from itertools import islice
from typing import TypeVar

from magmatch.errors import ConfigurationError, TaskError
from magmatch.threads import on_one_core
from magmatch.workers import DaskRunner

A = TypeVar("A")
T = TypeVar("T")


def run_all(
    work: Callable[[A], T], parts: Iterable[A], jobs: int = 1, scheduler: str | None = None
) -> Iterator[tuple[A, T]]:
    """Do independent parts of some work, each on one core; yield part and result as they are finished.

    The work is a function of a module, so that other processes find it. Where a worker dies, `TaskError` is raised
    after what was finished has been given.
    """
    if jobs == 1 and scheduler is None:
        for part in parts:
            yield part, on_one_core(work, part)
        return
    source, running = iter(parts), dict[Future[T], A]()
    with _executor(jobs, scheduler) as (executor, n_at_once):
        while True:
            # Not everything is handed out at once: a run that ends early ends soon.
            for part in islice(source, n_at_once - len(running)):
                running[executor.submit(on_one_core, work, part)] = part
            if not running:
                return
            for future in wait(running, return_when=FIRST_COMPLETED).done:
                part = running.pop(future)
                try:
                    yield part, future.result()
                except BrokenProcessPool as error:
                    msg = "a worker process died (out of memory?); what was finished is kept, run again to go on"
                    raise TaskError(msg) from error


@contextmanager
def _executor(jobs: int, scheduler: str | None) -> Iterator[tuple[Executor, int]]:
    """Give an executor and how many parts it should hold."""
    if scheduler is None:
        # Spawned: a fork would copy threads of BLAS and numba in any state.
        with ProcessPoolExecutor(jobs, multiprocessing.get_context("spawn")) as pool:
            yield pool, jobs + 1
        return
    if "://" not in scheduler:
        msg = f"--scheduler: expected an address such as tcp://10.0.0.1:8786, found '{scheduler}'"
        raise ConfigurationError(msg)
    with DaskRunner(scheduler=scheduler) as runner, runner.client.get_executor(pure=False) as pool:
        yield pool, max(1, sum(runner.client.nthreads().values())) + 1
