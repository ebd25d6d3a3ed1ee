# SPDX-License-Identifier: BSD-3-Clause
"""The figures of README: this method and the published one on the same pairs, in two minutes on two idle cores.

    python benchmarks/headline.py [--jobs 2] [--out DIR] [--minutes M] [--check] [--save headline]

Right is accepted and within tolerance, or refused where there is nothing to find. Intervals are of 95 %: a rate's is
Wilson's; a median's the order statistics that enclose it, however errors are distributed, none where a trial has no
pose at all. ``--check`` fails where a figure leaves the interval that README states of it. Rows stay in DIR, and are
taken again as long as the code is the same. The saved table covers this script alone: CI takes its figures anew at
each change, so no change of the code makes them old.
"""

import math
import sys
import time
from collections.abc import Iterator, Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
from scipy.stats import binom

from magmatch.simulation.config import SimulationConfig
from magmatch_evaluation.benchmark import evaluate
from magmatch_evaluation.experiments import EXPERIMENTS, Experiment, Tolerance
from magmatch_evaluation.plan import chosen_methods, make_plan
from magmatch_evaluation.rows import Row
from magmatch_evaluation.saved_table import FOLDER, ResultTable, saver, show
from magmatch_evaluation.script import arguments
from magmatch_evaluation.statistics import is_right, wilson_interval
from magmatch_evaluation.survey_pairs import Simulated

COLUMNS = ("pairs", "method", "right", "wrongly accepted", "median, mm", "median, deg")
# Experiments by their names, with the methods that README compares.
NAMED = {"office-z30": ("default", "paper"), "corridor": ("default", "paper"), "nowhere": ("default",)}
# Of `experiments/many_rooms.py`: share of the target's region that is covered; tolerance in m and degrees.
ROOMS = {1.0: (0.005, 0.2), 0.5: (0.015, 0.4), 0.15: (0.03, 0.8)}
N_TRIALS = 10
# Seeds that CI compares with README; looked at often.
FIRST = 1000


def experiments() -> list[Experiment]:
    """What is asked, with its methods and its number of trials."""
    named = [replace(EXPERIMENTS[name], n_seeds=N_TRIALS, methods=methods) for name, methods in NAMED.items()]
    return named + [
        Experiment(
            f"rooms, {overlap:.0%} overlap", "", "rooms",
            Simulated("office-random", SimulationConfig(room_size=(3.0, 3.0, 0.6), overlap=overlap)),
            N_TRIALS, ("default",), Tolerance(*tolerance),
        )
        for overlap, tolerance in ROOMS.items()
    ]  # fmt: skip


def enclosing(values: Sequence[float]) -> tuple[float, float, float]:
    """Median, and the innermost order statistics that enclose the true one with 95 %; of under six values, all."""
    ordered, n = np.sort(values), len(values)
    k = max(int(binom.ppf(0.025, n, 0.5)) - 1, 0)
    return float(np.median(ordered)), float(ordered[k]), float(ordered[n - 1 - k])


def rate(k: int, n: int) -> str:
    """Lay out a rate with its interval."""
    low, high = wilson_interval(k, n)
    return f"{k} of {n} ({100 * low:.0f} to {100 * high:.0f} %)"


def middle(errors: Sequence[float], digits: int) -> str:
    """Lay out a median with its interval."""
    if not np.isfinite(errors).all():
        return "-"
    at, low, high = (f"{value:.{digits}f}" for value in enclosing(errors))
    return f"{at} ({low} to {high})"


def line(experiment: Experiment, method: str, rows: Sequence[Row]) -> list[str]:
    """Lay out one method in one experiment."""
    n, is_there = len(rows), rows[0].is_there
    answers = [(row.is_accepted, is_right(row, experiment.tolerance), row.status == "fault") for row in rows]
    right = sum(near if accepted else not (is_there or fault) for accepted, near, fault in answers)
    wrong = sum(accepted and not near for accepted, near, _ in answers)
    errors = [[1e3 * row.distance, math.degrees(row.angle)] for row in rows if is_there] or [[math.inf, math.inf]]
    medians = (middle(of, digits) for of, digits in zip(zip(*errors, strict=True), (1, 2), strict=True))
    return [experiment.name, method, rate(right, n), rate(wrong, n), *medians]


def parts(cell: str) -> list[float]:
    """Read a laid out figure: the figure itself (of a rate, its percent), and the ends of its interval."""
    figure, interval = cell.removesuffix(")").split(" (")
    k, *n = map(float, figure.split(" of "))
    return [100 * k / n[0] if n else k, *map(float, interval.removesuffix(" %").split(" to "))]


def outside(rows: Sequence[Sequence[str]], stated: ResultTable) -> Iterator[str]:
    """Say which figures lie outside their stated intervals, and what is in one table alone."""
    known = {tuple(row[:2]): row for row in stated.rows}
    for row in rows:
        before = known.pop(tuple(row[:2]), None)
        if before is None:
            yield f"{row[0]}, {row[1]}: no such row in README"
            continue
        for column, now, then in list(zip(COLUMNS, row, before, strict=True))[2:]:
            if "-" in (now, then):
                is_kept = now == then
            else:
                _, low, high = parts(then)
                is_kept = low <= parts(now)[0] <= high
            if not is_kept:
                yield f"{row[0]}, {row[1]}: {column} is {now}, README states {then}"
    yield from (f"{name}, {method}: not asked any more" for name, method in known)


def main() -> int:
    asked = arguments(__doc__, jobs=2, out=Path("headline-output"), minutes=math.inf, check=False, save=saver)
    plan = make_plan(experiments(), chosen_methods("default,paper"), first_seed=FIRST)
    deadline = time.monotonic() + 60 * asked.minutes
    found = [row for row in evaluate(plan, asked.out, jobs=asked.jobs, deadline=deadline) if isinstance(row, Row)]
    rows = [
        line(e, method, of)
        for e in plan.experiments
        for method in e.methods
        if (of := [row for row in found if (row.experiment, row.method) == (e.name, method)])
    ]
    show(COLUMNS, rows, asked.save)
    wrong = list(outside(rows, ResultTable.load(FOLDER / "headline.json"))) if asked.check else []
    print("\n".join(f"headline: {each}" for each in wrong), file=sys.stderr, end="\n" if wrong else "")
    return 1 if wrong else 0


if __name__ == "__main__":
    sys.exit(main())
