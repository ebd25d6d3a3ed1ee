# SPDX-License-Identifier: BSD-3-Clause
"""How far a run is, and how long the rest may take."""

import time
from collections.abc import Iterable, Sequence
from dataclasses import dataclass

from magmatch_evaluation.rows import AnyRow
from magmatch_evaluation.trial import Batch


@dataclass(frozen=True, slots=True)
class Progress:
    """How far a run is, in trials, those of earlier runs included.

    The seconds left are reckoned from what this run's trials took so far; None before the first.
    """

    n_done: int
    n_all: int
    seconds_left: float | None = None
    last: Batch | None = None


class TimeEstimator:
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
