# SPDX-License-Identifier: BSD-3-Clause
"""The verb: experiments and methods in, rows out, whatever interrupts it on the way."""

import math
import time
from collections.abc import Callable
from dataclasses import dataclass
from itertools import takewhile
from pathlib import Path

from magmatch_evaluation.parallel import run_all
from magmatch_evaluation.plan import Plan
from magmatch_evaluation.rows import AnyRow, MapRow, Row, RowFile, write_csv
from magmatch_evaluation.trial import Batch, run_batch


@dataclass(frozen=True, slots=True)
class Progress:
    """How far a run is, in trials, those of earlier runs included; the rest at the pace of this run's so far."""

    n_done: int
    n_all: int
    seconds_left: float | None = None  # None before the first
    last: Batch | None = None


def evaluate(
    plan: Plan,
    folder: Path,
    *,
    jobs: int = 1,
    scheduler: str | None = None,
    tell: Callable[[Progress], None] = lambda _: None,
    deadline: float = math.inf,
) -> list[AnyRow]:
    """Run the trials of a plan that have not been run yet; rows of the whole plan, in the plan's order.

    Rows are kept in the folder; those of an earlier run with the same settings are taken as they are. ``jobs`` are
    processes on this machine; ``scheduler`` is the address of a Dask scheduler whose workers do it instead. No trial
    is begun after the deadline, on the clock of `time.monotonic`.
    """
    folder.mkdir(parents=True, exist_ok=True)
    files = [RowFile[AnyRow](folder / f"{kind.FILE}.jsonl", kind) for kind in (Row, MapRow)]
    wanted = plan.keys()

    def kept() -> list[AnyRow]:
        return sorted((row for file in files for row in file.read() if row.key in wanted), key=lambda row: row.key)

    for file in files:
        file.mend()
    known = kept()
    todo = plan.remaining({row.key for row in known})
    n_known, n_done, start = len(known), len(known), time.monotonic()
    tell(Progress(n_known, len(wanted)))
    in_time = takewhile(lambda _: time.monotonic() < deadline, todo)
    for batch, rows in run_all(run_batch, in_time, jobs, scheduler):
        for file in files:
            if own := [row for row in rows if isinstance(row, file.kind)]:
                file.append(own)
        n_done += len(rows)
        # Each seed asks all that the one before did: trials of all kinds come evenly.
        pace = (time.monotonic() - start) / (n_done - n_known)
        tell(Progress(n_done, len(wanted), pace * (len(wanted) - n_done), batch))
    found = kept()
    for file in files:
        if file.path.exists():
            own = [row for row in found if isinstance(row, file.kind)]
            write_csv(file.path.with_suffix(".csv"), own, file.kind)
    return found
