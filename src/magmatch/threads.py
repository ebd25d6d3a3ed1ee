# SPDX-License-Identifier: BSD-3-Clause
"""Use of cores: one BLAS thread per task, and the halves of a task in parallel if cores are free.

Results do not depend, to the bit, on what else runs, and worker processes do not compete for cores.
"""

import os
import sys
from collections.abc import Callable, Iterable, Iterator
from concurrent.futures import ThreadPoolExecutor, wait
from contextlib import contextmanager
from contextvars import ContextVar, copy_context
from functools import partial
from threading import Lock, Semaphore
from typing import ParamSpec, TypeVar, cast

from threadpoolctl import threadpool_limits

P = ParamSpec("P")
T = TypeVar("T")
A = TypeVar("A")

# Seconds after which a thread that holds the interpreter lets another in, while parts run: they hold it for
# microseconds between compiled calls of a millisecond, and as a rule would wait for five to get it back.
QUICK_TURNS = 5e-5
_is_worker: ContextVar[bool] = ContextVar("is_worker", default=False)


class WhileAnyone:
    """A state of the whole process that lasts from the first thread that needs it to the last."""

    def __init__(self, begin: Callable[[], Callable[[], None]]) -> None:
        self._begin, self._lock, self._n = begin, Lock(), 0
        self._end: Callable[[], None] | None = None

    @contextmanager
    def __call__(self) -> Iterator[None]:
        """For the block."""
        with self._lock:
            if self._n == 0:
                self._end = self._begin()
            self._n += 1
        try:
            yield
        finally:
            with self._lock:
                self._n -= 1
                if self._n == 0 and self._end is not None:
                    self._end()


def _take_quick_turns() -> Callable[[], None]:
    usual = sys.getswitchinterval()
    sys.setswitchinterval(QUICK_TURNS)
    return partial(sys.setswitchinterval, usual)


# To set the limit takes a millisecond or two; tasks within tasks do not set it again.
one_blas_thread = WhileAnyone(lambda: threadpool_limits(limits=1).restore_original_limits)
# Decorates a task that runs with one BLAS thread, whatever the environment says.
single_threaded = one_blas_thread()
quick_turns = WhileAnyone(_take_quick_turns)


def on_one_core(task: Callable[P, T], *args: P.args, **kwargs: P.kwargs) -> T:
    """Run a task whose siblings use the other cores: in worker processes."""
    token = _is_worker.set(True)
    try:
        return task(*args, **kwargs)
    finally:
        _is_worker.reset(token)


def side_by_side(task: Callable[[A], T], parts: Iterable[A]) -> list[T]:
    """Run a task on independent parts, in parallel where cores are free; results in the parts' order.

    The task releases the interpreter most of the time (BLAS, compiled loops) and writes where no other part does. A
    part may itself be cut into parts. After an error no further part begins.
    """
    listed = list(parts)
    n_helpers = 0 if _is_worker.get() else _take_spare_cores(len(listed) - 1)
    if n_helpers == 0:
        return [task(part) for part in listed]
    numbers, results, leaving = iter(range(len(listed))), [cast("T", None)] * len(listed), iter(range(n_helpers))

    def work() -> None:
        try:
            # The next number is given to one thread only: iterators of ranges hold the interpreter.
            for k in numbers:
                results[k] = task(listed[k])
        except BaseException:
            # A fault, or Ctrl-C: nobody begins another part.
            list(numbers)
            raise
        finally:
            # Whoever finds nothing left gives a core back; the last one's is the caller's own.
            if next(leaving, None) is not None:
                _spare_cores.release()

    with quick_turns(), ThreadPoolExecutor(n_helpers) as pool:
        helpers = [pool.submit(copy_context().run, work) for _ in range(n_helpers)]
        try:
            work()
        finally:
            wait(helpers)
    for helper in helpers:
        helper.result()
    return results


def slices(n: int) -> list[slice]:
    """Rows cut into as many slices as there are cores."""
    size = max(1, -(-n // _n_cores()))
    return [slice(start, min(start + size, n)) for start in range(0, n, size)]


def _n_cores() -> int:
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1


# Cores of this process that no thread is at work on, beside that of whoever asks.
_spare_cores = Semaphore(_n_cores() - 1)


def _take_spare_cores(most: int) -> int:
    """As many as are free, without waiting for any."""
    n = 0
    while n < most and _spare_cores.acquire(blocking=False):
        n += 1
    return n
