# SPDX-License-Identifier: BSD-3-Clause
"""Who does the work: this process, others on this machine, or the workers of a Dask scheduler."""

import multiprocessing
import time
from collections.abc import Callable, Iterable, Iterator
from concurrent.futures import FIRST_COMPLETED, Executor, Future, ProcessPoolExecutor, wait
from concurrent.futures.process import BrokenProcessPool
from contextlib import contextmanager
from itertools import islice
from typing import Any, TypeVar

from magmatch.errors import ConfigurationError, MissingExtraError, TaskError
from magmatch.threads import on_one_core

A = TypeVar("A")
T = TypeVar("T")

CONNECT_SECONDS = 10


def run_all(
    work: Callable[[A], T], parts: Iterable[A], jobs: int = 1, scheduler: str | None = None
) -> Iterator[tuple[A, T]]:
    """Do independent parts of some work, each on one core.

    Parameters
    ----------
    work : callable
        A function of a module, so that other processes find it.
    parts : iterable
    jobs : int
        Processes on this machine.
    scheduler : str, optional
        Address of a Dask scheduler, ``tcp://host:port``, whose workers are used instead.

    Yields
    ------
    part, result
        As they are finished.

    Raises
    ------
    ConfigurationError
        No scheduler answers.
    MissingExtraError
        Dask is not installed.
    TaskError
        A worker died; what was finished has been given.
    """
    if jobs == 1 and scheduler is None:
        for part in parts:
            yield part, on_one_core(work, part)
        return
    with _executor(jobs, scheduler) as (executor, n_at_once):
        yield from _as_finished(executor, work, iter(parts), n_at_once)


def until(deadline: float, parts: Iterable[A]) -> Iterator[A]:
    """Give parts as long as there is time.

    Parameters
    ----------
    deadline : float, s
        On the clock of `time.monotonic`; infinity for no end.
    parts : iterable

    Yields
    ------
    part
    """
    for part in parts:
        if time.monotonic() >= deadline:
            return
        yield part


def _as_finished(
    executor: Executor, work: Callable[[A], T], parts: Iterator[A], n_at_once: int
) -> Iterator[tuple[A, T]]:
    """Keep the workers busy without handing out everything at once: a run that ends early ends soon."""
    running: dict[Future[T], A] = {}
    while True:
        for part in islice(parts, n_at_once - len(running)):
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
    try:
        from distributed import Client
    except ImportError:
        feature = "an evaluation on the workers of a scheduler"
        raise MissingExtraError(feature, "distributed") from None
    make_client: Any = Client
    try:
        client = make_client(scheduler, timeout=CONNECT_SECONDS, set_as_default=False)
    except OSError as error:
        msg = f"no Dask scheduler answers at {scheduler} within {CONNECT_SECONDS} s"
        raise ConfigurationError(msg) from error
    with client, client.get_executor(pure=False) as pool:
        yield pool, max(1, sum(client.nthreads().values())) + 1
