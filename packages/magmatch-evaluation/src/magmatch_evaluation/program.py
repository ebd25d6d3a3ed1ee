# SPDX-License-Identifier: BSD-3-Clause
"""``magmatch evaluate``: the benchmark, in one command that can be interrupted."""

import math
import sys
import time
from argparse import ArgumentTypeError
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from magmatch.atomic import write_whole
from magmatch.cli.command import command
from magmatch.cli.narration import put, say
from magmatch.cli.outputs import check_folder

if TYPE_CHECKING:
    from magmatch_evaluation.benchmark import Progress
    from magmatch_evaluation.experiments import Experiment
    from magmatch_evaluation.saved_table import Saver

EXAMPLES = (
    "magmatch evaluate list",
    "magmatch evaluate --quick",
    "magmatch evaluate office-z30 refusals --seeds 5 --methods default,paper",
    "magmatch evaluate --jobs 2 --out results --from ~/recordings",
)
# Where stderr is no terminal, a line of progress now and then.
TELL_SECONDS = 30.0
# Options for paths and computing time, on which the results do not depend.
PLACES = ("--out", "--from", "--scheduler", "--minutes")


@command("evaluate", EXAMPLES)
def evaluate(
    names: Annotated[
        list[str] | None,
        typer.Argument(help="Experiments or groups of them; all by default; 'list' lists them.", metavar="[NAMES]"),
    ] = None,
    quick: Annotated[bool, typer.Option("--quick", help="A small run, under two minutes.")] = False,
    methods: Annotated[str | None, typer.Option(help="Only these methods, separated by commas.")] = None,
    seeds: Annotated[int | None, typer.Option(min=1, help="Most trials of each experiment and method.")] = None,
    first: Annotated[
        int, typer.Option(min=0, help="First seed; seeds below 1000 were used during development.")
    ] = 1000,
    recordings: Annotated[
        Path | None, typer.Option("--from", help="Folder of public recordings; the cache by default.", metavar="DIR")
    ] = None,
    out: Annotated[Path, typer.Option(help="Folder for rows, tables and report; existing rows are reused.")] = Path(
        "magmatch-evaluation"
    ),
    jobs: Annotated[int, typer.Option(min=1, help="Processes.")] = 1,
    scheduler: Annotated[
        str | None, typer.Option(help="Dask scheduler whose workers run the trials instead, tcp://HOST:PORT.")
    ] = None,
    minutes: Annotated[
        float | None,
        typer.Option(min=0, help="Start no trial after this time, and report on those finished; 0 only reports."),
    ] = None,
    save: Annotated[bool, typer.Option("--save", help="Also save the tables in benchmarks/results.")] = False,
) -> None:
    """Run the benchmark: several methods on the same pairs.

    Trials are paired by seed. Every finished trial is stored in the folder, so an interrupted run resumes where it
    stopped.
    """
    if names == ["list"]:
        _list()
        return
    check_folder(out)
    from magmatch_evaluation import benchmark, findings, plan

    planned = plan.make_plan(
        plan.chosen_experiments(names or (), quick=quick), plan.chosen_methods(methods),
        n_seeds=seeds, first_seed=first, recordings=recordings,
    )  # fmt: skip
    savers = _savers(planned.experiments) if save else {}
    deadline = math.inf if minutes is None else time.monotonic() + 60 * minutes
    rows = benchmark.evaluate(planned, out, jobs=jobs, scheduler=scheduler, tell=_Teller(), deadline=deadline)
    found = findings.Findings(planned.experiments, rows, planned.left_out, _command(), len(planned.keys()))
    for what, why in found.left_out.items():
        say(f"Left out: {what}: {why}")
    text = findings.markdown(found)
    write_whole(out / "results.md", text.encode())
    if save:
        findings.save_tables(found, savers)
    put(text)
    findings.write_html(out / "report.html", found)
    say(f"{len(rows)} trials; rows, tables and report are in {out}")


def _savers(experiments: "Sequence[Experiment]") -> "dict[str, Saver]":
    """One saver per table; a table that cannot be saved is refused before the work."""
    from magmatch_evaluation.findings import BEHIND, COSTS
    from magmatch_evaluation.saved_table import saver

    try:
        return {name: saver(f"evaluation-{name}") for name in ({e.group for e in experiments} | {COSTS, BEHIND})}
    except ArgumentTypeError as error:
        raise typer.BadParameter(str(error)) from None


class _Teller:
    """Says on stderr how far a run is: in place where it is a terminal, else a line now and then."""

    def __init__(self) -> None:
        self._last_told = 0.0

    def __call__(self, progress: "Progress") -> None:
        left = "" if progress.seconds_left is None else f", about {_duration(progress.seconds_left)} left"
        last = "" if progress.last is None else f" ({progress.last.experiment.name}, seed {progress.last.seed})"
        text = f"{progress.n_done} of {progress.n_all} trials{left}{last}"
        is_over = progress.n_done == progress.n_all
        if sys.stderr.isatty():
            print(f"\r\x1b[K{text}", end="\n" if is_over else "", file=sys.stderr, flush=True)  # noqa: T201
        elif is_over or time.monotonic() - self._last_told > TELL_SECONDS:
            say(text)
            self._last_told = time.monotonic()


def _duration(seconds: float) -> str:
    """Say a duration in the unit that suits it."""
    if seconds < 90:
        return f"{seconds:.0f} s"
    return f"{seconds / 60:.0f} min" if seconds < 5400 else f"{seconds / 3600:.1f} h"


def _list() -> None:
    """List experiments by group, and methods."""
    from magmatch_evaluation.experiments import EXPERIMENTS
    from magmatch_evaluation.plan import ALL

    put("Experiments:")
    group = ""
    for experiment in EXPERIMENTS.values():
        if experiment.group != group:
            group = experiment.group
            put(f"  {group}")
        put(f"    {experiment.name:20}  {experiment.title} ({experiment.n_seeds} trials a method)")
    put("Methods:")
    for method in ALL.values():
        put(f"    {method.name:20}  {method.title}{f' (needs {method.module})' if method.module else ''}")


def _command() -> str:
    """Give the words of this run, without where its files lie."""
    words, kept = iter(sys.argv[1:]), ["magmatch"]
    for word in words:
        if word in PLACES:
            next(words, None)
        elif word != "--save" and not word.startswith(tuple(f"{place}=" for place in PLACES)):
            kept.append(word)
    return " ".join(kept)
