# SPDX-License-Identifier: BSD-3-Clause
"""Who may use which cores: one BLAS thread per task, and the halves of a task side by side where cores are free.

The same bits come out whatever else runs, and worker processes do not fight over cores.
"""

import os
import sys
from collections.abc import Callable, Iterable, Iterator
from concurrent.futures import ThreadPoolExecutor, wait
from contextlib import contextmanager
from contextvars import ContextVar, copy_context
from functools import wraps
from threading import Lock, Semaphore
from typing import ParamSpec, TypeVar, cast

from threadpoolctl import threadpool_limits

P = ParamSpec("P")
T = TypeVar("T")
A = TypeVar("A")

# Seconds after which a thread that holds the interpreter lets another in, while parts run: they hold it for
# microseconds between compiled calls of a millisecond, and as a rule would wait for five to get it back.
QUICK_TURNS = 5e-5
_turns_lock, _usual_turns = Lock(), list[float]()
_is_worker: ContextVar[bool] = ContextVar("is_worker", default=False)
_is_limited: ContextVar[bool] = ContextVar("is_limited", default=False)


def single_threaded(task: Callable[P, T]) -> Callable[P, T]:
    """Run a task with one BLAS thread, whatever the environment says.

    Parameters
    ----------
    task : callable

    Returns
    -------
    callable
        The same, with the limit in force while it runs.
    """

    @wraps(task)
    def limited(*args: P.args, **kwargs: P.kwargs) -> T:
        # To set the limit takes a millisecond or two: once is enough.
        if _is_limited.get():
            return task(*args, **kwargs)
        token = _is_limited.set(True)
        try:
            with threadpool_limits(limits=1):
                return task(*args, **kwargs)
        finally:
            _is_limited.reset(token)

    return limited


def on_one_core(task: Callable[P, T], *args: P.args, **kwargs: P.kwargs) -> T:
    """Run a task whose siblings use the other cores: in worker processes."""
    token = _is_worker.set(True)
    try:
        return task(*args, **kwargs)
    finally:
        _is_worker.reset(token)


def side_by_side(task: Callable[[A], T], parts: Iterable[A]) -> list[T]:
    """Run a task on independent parts, at once where there are cores for it.

    A part may itself be cut into parts: they take the cores that are free by then.

    Parameters
    ----------
    task : callable
        Releases the interpreter most of the time (BLAS, compiled loops) and writes where no other part does.
    parts : iterable
        One argument each.

    Returns
    -------
    list
        What each part gave, in their order. Raises what the first of them raised.
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
        finally:
            # Whoever finds nothing left gives a core back; the last one's is the caller's own.
            if next(leaving, None) is not None:
                _spare_cores.release()

    with _taking_turns(), ThreadPoolExecutor(n_helpers) as pool:
        helpers = [pool.submit(copy_context().run, work) for _ in range(n_helpers)]
        try:
            work()
        finally:
            wait(helpers)
    for helper in helpers:
        helper.result()
    return results


def slices(n: int) -> list[slice]:
    """Rows cut into as many slices as there are cores: parts of independent rows for `side_by_side`.

    Parameters
    ----------
    n : int
        Number of rows.

    Returns
    -------
    list of slice
    """
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


@contextmanager
def _taking_turns() -> Iterator[None]:
    """Threads take turns quickly; the last who asked for it puts back what was the rule."""
    with _turns_lock:
        _usual_turns.append(sys.getswitchinterval())
        sys.setswitchinterval(QUICK_TURNS)
    try:
        yield
    finally:
        with _turns_lock:
            # The first found what was the rule, all others what it had set.
            sys.setswitchinterval(_usual_turns[0] if len(_usual_turns) == 1 else QUICK_TURNS)
            _usual_turns.pop()
