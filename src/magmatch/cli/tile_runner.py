# SPDX-License-Identifier: BSD-3-Clause
"""Where the tiles of a large map are fitted."""

from collections.abc import Iterator
from contextlib import contextmanager
from typing import TYPE_CHECKING

from magmatch.errors import ConfigurationError

if TYPE_CHECKING:
    from magmatch.field.linear_model import Runner


@contextmanager
def runner(jobs: int, scheduler: str | None) -> "Iterator[Runner]":
    """Give the runner for the tasks of a tiled map: this process, others on this machine, or a cluster."""
    if jobs == 1 and scheduler is None:
        yield map
        return
    from magmatch.field.tiles.distributed import DaskRunner

    if scheduler is not None and "://" not in scheduler:
        msg = f"--scheduler: expected an address such as tcp://10.0.0.1:8786, found '{scheduler}'"
        raise ConfigurationError(msg)
    with DaskRunner(jobs, scheduler) as run:
        yield run
