# SPDX-License-Identifier: BSD-3-Clause
"""Who may use which cores: one BLAS thread per task, and the halves of a task side by side where cores are free.

The same bits come out whatever else runs, and worker processes do not fight over cores.
"""

import os
from collections.abc import Callable, Iterable
from concurrent.futures import ThreadPoolExecutor
from contextvars import ContextVar
from functools import wraps
from typing import ParamSpec, TypeVar

from threadpoolctl import threadpool_limits

P = ParamSpec("P")
T = TypeVar("T")
A = TypeVar("A")

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


def side_by_side(task: Callable[[A], None], parts: Iterable[A]) -> None:
    """Run a task on independent parts, at once where there are cores for it.

    Parameters
    ----------
    task : callable
        Releases the interpreter most of the time (BLAS, compiled loops) and writes where no other part does.
    parts : iterable
        One argument each.
    """
    listed = list(parts)
    n = min(len(listed), _n_cores())
    if n < 2 or _is_worker.get():
        for part in listed:
            task(part)
        return
    with ThreadPoolExecutor(n) as pool:
        # Waits for all, and raises what the first of them raised.
        list(pool.map(task, listed))


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
