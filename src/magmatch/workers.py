# SPDX-License-Identifier: BSD-3-Clause
"""Tasks done by worker processes through Dask: on this machine, or on a cluster that is running already.

Each task depends on itself alone and runs one BLAS thread, so it gives the same bits wherever and however often it
runs: a worker that dies in the middle costs time and nothing else. Few tasks are on their way at any time, so memory
does not grow with their number.
"""

import logging
from collections.abc import Callable, Iterable, Iterator
from contextlib import ExitStack
from dataclasses import dataclass
from functools import cached_property
from itertools import islice
from queue import Empty, Queue
from typing import Any, Self, TypeVar

from magmatch.arguments import whole_number_of
from magmatch.errors import ConfigurationError, TaskError, import_extra
from magmatch.threads import on_one_core

log = logging.getLogger(__name__)

# Results that may wait for an earlier one.
MOST_WAITING = 100
# Workers that one task may take down with it before it is given up.
MOST_DEATHS = 5
CONNECT_SECONDS = 10
# How often to look after the workers, and how long to wait for one where there is none.
LOOK_SECONDS, LONELY_SECONDS = 2, 120


@dataclass(frozen=True, eq=False, slots=True)
class Task:
    """Arguments of a function, and in words what comes of them, for messages."""

    name: str
    arguments: tuple[Any, ...]
    affinity: int | None = None  # tasks of one number had better be done by one worker, which has what they share


R = TypeVar("R")


class DaskRunner:
    """Runs tasks on Dask workers; a context manager that ends those it started.

    Examples
    --------
    ``with DaskRunner(jobs=4) as run: field_map = build_map(survey, run=run)``
    """

    def __init__(self, jobs: int = 2, scheduler: str | None = None, ahead: int = 1) -> None:
        # Tasks per thread of a worker that are on their way: more than one if they are short. Of a worker that dies,
        # all of its tasks are to blame.
        self.jobs, self.ahead = whole_number_of(jobs, "jobs", 1), whole_number_of(ahead, "ahead", 1)
        self.scheduler = scheduler
        self._open = ExitStack()
        import_extra("distributed", "work in several processes", "distributed")

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self._open.close()

    def __call__(self, function: Callable[[Task], R], tasks: Iterable[Task]) -> Iterator[R]:
        """Apply a function to every task, results in the order of the tasks."""
        client, source = self.client, enumerate(tasks)
        running: dict[Any, tuple[int, Task]] = {}
        done: dict[int, R] = {}
        finished: Queue[Any] = Queue()
        n_given = 0
        try:
            while True:
                workers = dict(sorted(client.nthreads().items()))
                n_idle = self.ahead * max(1, sum(workers.values())) - len(running)
                for number, task in islice(source, max(0, n_idle) if len(done) < MOST_WAITING else 0):
                    place = _place(task, list(workers))
                    future = client.submit(on_one_core, function, task, pure=False, **place)
                    running[future] = number, task
                    future.add_done_callback(finished.put)
                while n_given in done:
                    yield done.pop(n_given)
                    n_given += 1
                if not running:
                    return
                future = _next(finished, client)
                number, task = running.pop(future)
                done[number] = _result(task, future)
        finally:
            for future in running:
                future.cancel()

    @cached_property
    def client(self) -> Any:
        """Dask client; workers are started, or those of the scheduler found, when the first task comes."""
        import dask
        from distributed import Client

        settings = {
            "distributed.scheduler.allowed-failures": MOST_DEATHS - 1,
            # A worker that died comes back, however slowly a busy machine starts it.
            "distributed.deploy.lost-worker-timeout": f"{LONELY_SECONDS}s",
        }
        self._open.enter_context(dask.config.set(settings))
        make_client: Any = Client
        try:
            place = meet(self.scheduler) if self.scheduler else self._open.enter_context(self._local_cluster())
            return self._open.enter_context(make_client(place, timeout=CONNECT_SECONDS, set_as_default=False))
        except (OSError, MemoryError, ValueError) as error:
            msg = f"no Dask scheduler answers at {self.scheduler} within {CONNECT_SECONDS} s"
            raise ConfigurationError(msg) from error

    def _local_cluster(self) -> Any:
        """Worker processes on this machine, each with one thread."""
        from distributed import LocalCluster

        log.info("starting %d worker processes", self.jobs)
        make_cluster: Any = LocalCluster
        return make_cluster(
            n_workers=self.jobs, threads_per_worker=1, processes=True, dashboard_address="127.0.0.1:0",
            silence_logs=logging.CRITICAL,
        )  # fmt: skip


def meet(address: str) -> str:
    """Give the address of what talks as Dask does: a client that met another server could not be closed."""
    from distributed.comm.core import connect
    from distributed.utils import LoopRunner, sync

    runner: Any = LoopRunner()
    runner.start()
    try:
        sync(runner.loop, connect, address, timeout=CONNECT_SECONDS).abort()
    finally:
        runner.stop()
    return address


def _place(task: Task, workers: list[str]) -> dict[str, Any]:
    """The worker that a task had better be done by, while it is there."""
    if task.affinity is None or not workers:
        return {}
    return {"workers": [workers[task.affinity % len(workers)]], "allow_other_workers": True}


def _next(finished: "Queue[Any]", client: Any) -> Any:
    """Wait for a task that is done, as long as there is a worker to do it."""
    waited = 0
    while True:
        try:
            return finished.get(timeout=LOOK_SECONDS)
        except Empty:
            waited = 0 if client.nthreads() else waited + LOOK_SECONDS
            if waited >= LONELY_SECONDS:
                msg = f"no worker has been there for {LONELY_SECONDS} s; start some, then run again"
                raise TaskError(msg) from None


def _result(task: Task, future: Any) -> Any:
    """Give the result of a task, or what befell it in one line."""
    from distributed import CancelledError, KilledWorker

    name = task.name
    try:
        return future.result()
    except KilledWorker as error:
        msg = f"{name} took down several workers one after the other (out of memory?) and was given up"
        raise TaskError(msg) from error
    except CancelledError as error:
        msg = f"{name} was lost: the scheduler or all of its workers are gone"
        raise TaskError(msg) from error
    except Exception as error:
        what = " ".join(str(error).split()) or type(error).__name__
        msg = f"{name} failed on a worker: {what}"
        raise TaskError(msg) from error
