# SPDX-License-Identifier: BSD-3-Clause
"""Work in other processes: of this machine, or of a Dask cluster."""

from collections.abc import Iterator
from contextlib import contextmanager
from typing import TYPE_CHECKING

from magmatch.cli.option_values import refuse

if TYPE_CHECKING:
    from magmatch.workers import DaskRunner


@contextmanager
def processes(jobs: int, scheduler: str | None, ahead: int = 1) -> "Iterator[DaskRunner | None]":
    """Give what runs tasks in other processes, or None where this one does all of the work."""
    if jobs == 1 and scheduler is None:
        yield None
        return
    from magmatch.workers import DaskRunner

    if scheduler is not None and "://" not in scheduler:
        refuse("--scheduler", "an address such as tcp://10.0.0.1:8786", scheduler)
    with DaskRunner(jobs, scheduler, ahead) as run:
        if scheduler is not None:
            _ = run.client  # before long work, whether it answers
        yield run
