# SPDX-License-Identifier: BSD-3-Clause
"""One BLAS thread per task: the same bits whatever else runs, and no fight over cores between worker processes."""

from collections.abc import Callable
from functools import wraps
from typing import ParamSpec, TypeVar

from threadpoolctl import threadpool_limits

P = ParamSpec("P")
T = TypeVar("T")


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
        with threadpool_limits(limits=1):
            return task(*args, **kwargs)

    return limited
