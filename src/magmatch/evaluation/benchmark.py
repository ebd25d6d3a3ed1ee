# SPDX-License-Identifier: BSD-3-Clause
"""The whole benchmark: what was asked for by name, run, and put together for the report."""

import math
import time
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

from magmatch.evaluation.mapping import PREDICTORS, MappingCase, MapTask, evaluate_maps
from magmatch.evaluation.plan import make_plan, missing_recordings
from magmatch.evaluation.report import Findings
from magmatch.evaluation.run import Progress, evaluate
from magmatch.evaluation.selection import chosen_cases, chosen_experiments, chosen_methods


@dataclass(frozen=True, slots=True)
class Settings:
    """What was asked for.

    Attributes
    ----------
    names : tuple of str
        Experiments, groups or mapping cases; all where empty.
    methods : str or None
        Names separated by commas; all where None.
    is_quick : bool
        The small experiments.
    n_seeds : int or None
        Most trials of each experiment and method.
    first_seed : int
    recordings : Path or None
        Folder of public recordings.
    seconds : float
        No trial is begun after this time; with 0 only what is there is put together.
    """

    names: tuple[str, ...] = ()
    methods: str | None = None
    is_quick: bool = False
    n_seeds: int | None = None
    first_seed: int = 1000
    recordings: Path | None = None
    seconds: float = math.inf


def run_benchmark(
    settings: Settings,
    folder: Path,
    *,
    jobs: int = 1,
    scheduler: str | None = None,
    tell: Callable[[Progress], None] = lambda _: None,
    command: str = "",
) -> Findings:
    """Run what was asked for, as far as it has not been run yet.

    Parameters
    ----------
    settings : Settings
    folder : Path
        Where rows are kept.
    jobs, scheduler, tell
        As of `magmatch.evaluation.run.evaluate`.
    command : str
        What was typed, for the record.

    Returns
    -------
    Findings
    """
    methods = chosen_methods(settings.methods)
    experiments = chosen_experiments(settings.names, quick=settings.is_quick)
    plan = make_plan(
        experiments, methods, n_seeds=settings.n_seeds, first_seed=settings.first_seed,
        recordings=settings.recordings,
    )  # fmt: skip
    cases = [] if settings.is_quick else chosen_cases(settings.names)
    missing = missing_recordings({case.dataset for case in cases}, settings.recordings)
    left_out = dict(plan.left_out) | {f"case {c.name}": missing[c.dataset] for c in cases if c.dataset in missing}
    tasks = [task for case in cases if case.dataset not in missing for task in _map_tasks(case, settings)]
    end = time.monotonic() + settings.seconds
    rows = evaluate(plan, folder, jobs=jobs, scheduler=scheduler, tell=tell, deadline=end) if plan.batches else []
    map_rows = evaluate_maps(tasks, folder, jobs=jobs, scheduler=scheduler, deadline=end) if tasks else []
    titles = {case.name: case.title for case in cases}
    n_planned = len(plan.keys()) + sum(len(task.predictors) for task in tasks)
    return Findings(plan.experiments, rows, map_rows, titles, left_out, command, n_planned)


def _map_tasks(case: MappingCase, settings: Settings) -> list[MapTask]:
    n_seeds = min(case.n_seeds, settings.n_seeds or case.n_seeds)
    return [MapTask(case, settings.first_seed + k, PREDICTORS, settings.recordings) for k in range(n_seeds)]
