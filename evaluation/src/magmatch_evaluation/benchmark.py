# SPDX-License-Identifier: BSD-3-Clause
"""The verb: experiments and methods in, rows out, whatever interrupts it on the way."""

import math
import time
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from pathlib import Path

from magmatch_evaluation.parallel import run_all, until
from magmatch_evaluation.plan import Plan
from magmatch_evaluation.rows import AnyRow, MapRow, Row, RowFile, write_csv
from magmatch_evaluation.trial import Batch, run_batch


@dataclass(frozen=True, slots=True)
class Progress:
    """How far a run is, in trials, those of earlier runs included.

    The seconds left are reckoned from what this run's trials took so far; None before the first.
    """

    n_done: int
    n_all: int
    seconds_left: float | None = None
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
    clock = _Clock(known, len(wanted), todo)
    tell(clock.progress())
    for batch, rows in run_all(run_batch, until(deadline, todo), jobs, scheduler):
        for file in files:
            if own := [row for row in rows if isinstance(row, file.kind)]:
                file.append(own)
        tell(clock.after(batch, rows))
    found = kept()
    for file in files:
        if file.path.exists():
            own = [row for row in found if isinstance(row, file.kind)]
            write_csv(file.path.with_suffix(".csv"), own, file.kind)
    return found


class _Clock:
    """Guesses the time left: what trials of the same kind took, scaled by how fast this run has been."""

    def __init__(self, known: Sequence[AnyRow], n_all: int, todo: Iterable[Batch]) -> None:
        self._n_done, self._n_all = len(known), n_all
        self._seconds: dict[str, list[float]] = {}
        self._todo = {(b.experiment.name, b.seed): b for b in todo}
        self._note(known)
        self._start, self._work = time.perf_counter(), 0.0

    def progress(self, last: Batch | None = None) -> Progress:
        """Say where the run stands."""
        if not self._work:
            return Progress(self._n_done, self._n_all, None, last)
        pace = (time.perf_counter() - self._start) / self._work
        left = sum(self._expected(b.experiment.name, m.name) for b in self._todo.values() for m in b.methods)
        return Progress(self._n_done, self._n_all, pace * left, last)

    def after(self, batch: Batch, rows: Sequence[AnyRow]) -> Progress:
        """Say where the run stands after one more batch."""
        self._todo.pop((batch.experiment.name, batch.seed))
        self._n_done += len(rows)
        self._work += sum(row.seconds for row in rows)
        self._note(rows)
        return self.progress(batch)

    def _note(self, rows: Iterable[AnyRow]) -> None:
        for row in rows:
            for kind in (f"{row.experiment} {row.method}", row.method, ""):
                self._seconds.setdefault(kind, []).append(row.seconds)

    def _expected(self, experiment: str, method: str) -> float:
        """Mean seconds of the most similar trials so far."""
        alike = next(self._seconds[kind] for kind in (f"{experiment} {method}", method, "") if kind in self._seconds)
        return sum(alike) / len(alike)
