# SPDX-License-Identifier: BSD-3-Clause
"""Renew the published tables, one script after the other: at most four hours on two cores.

    python benchmarks/renew_results.py [--dry-run] [--jobs 2] [--data DIR] [--out results-output] [--only NAME ...]

A script is not run where its tables are of the code as it is. What was interrupted goes on where it stood: scripts
keep their rows in the folder DIR of ``--out``, one for each commit. Seeds follow from the commit, so they are drawn
after the code was frozen, and used once. Recordings lie in ``--data``; where they do not,
scripts that need them are named and left out. The covered code must be committed.
"""

import os
import shlex
import subprocess
import sys
import zlib
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from write_results import History

from magmatch_evaluation.experiments import MAIN_METHODS
from magmatch_evaluation.held_out_field import PREDICTORS
from magmatch_evaluation.saved_table import FOLDER, ResultTable
from magmatch_evaluation.script import RECORDINGS, arguments


@dataclass(frozen=True)
class Run:
    """A command that fills tables."""

    tables: tuple[str, ...]
    # {jobs}, {data} (recordings), {out} (a folder of the run's own), {seed} and {methods} are filled in; options that
    # save are added.
    words: str
    minutes: float  # on two idle cores, estimated from seconds that the tables state
    saves: str = "--save {0}"  # the tables by their place

    @property
    def needs_data(self) -> bool:
        """Whether public recordings are read."""
        return "{data}" in self.words

    def command(self, jobs: int, data: Path | None, out: Path) -> list[str]:
        """Fill in the words; ``out`` is a folder for the commit, and bears its name."""
        own = out / self.tables[0]
        # Far from the seeds below a million, which served development.
        seed = 1_000_000 + zlib.crc32(f"{out.name} {self.tables[0]}".encode()) // 16
        words = f"{self.words} {self.saves.format(*self.tables)}"
        methods = ",".join((*MAIN_METHODS, *PREDICTORS))
        places = {"jobs": jobs, "data": shlex.quote(str(data)), "out": shlex.quote(str(own))}
        program, *rest = shlex.split(words.format(**places, seed=seed, methods=methods))
        if program == "evaluate":
            return [sys.executable, "-m", "magmatch", program, *rest]
        return [sys.executable, f"benchmarks/{program}", *rest]


# What takes little comes first: who stops early has the most of it.
RUNS = (
    Run(
        ("drifting-corridors",),
        "experiments/drifting_corridors.py --seeds 40 --first {seed} --jobs {jobs} --out {out}",
        14,
    ),
    Run(
        ("short-walks",),
        "experiments/short_walks.py --tries 200 --seed {seed} --jobs {jobs} --from {data} --out {out}",
        4,
    ),
    Run(
        ("many-buildings",),
        "experiments/many_buildings.py {out} --tries 100 --simulated 60 --absent 50 --seed {seed} --from {data}",
        12,
    ),
    Run(
        ("many-rooms", "different-places"),
        "experiments/many_rooms.py --first {seed} --rooms 50 --pairs 1000 --jobs {jobs} --out {out}",
        28,
        "--save {0} --save-pairs {1}",
    ),
    Run(("newcomers",), "experiments/newcomers.py --modes planar --jobs {jobs} --data {data} --out {out}", 20),
    Run(
        ("localize-others",),
        "experiments/localize_evidence.py --table others --jobs {jobs} --data {data} --out {out}",
        3,
    ),
    Run(
        ("held-out-walks",),
        "experiments/phones/held_out_walks.py --walks 60 --jobs {jobs} --data {data}/xyz10 --out {out}",
        12,
    ),
    Run(
        ("slam-scenarios",),
        "experiments/slam_scenarios.py --first {seed} --seeds 8 --drifts 1 --jobs {jobs} --out {out}",
        28,
    ),
    Run(
        ("evaluation-published", "evaluation-mapping", "evaluation-costs"),
        "evaluate office-z30 table-map table-robot corridor mapping --methods {methods} --seeds 8 --first {seed} "
        "--jobs {jobs} --from {data} --out {out}",
        24,
        "--save",
    ),
    Run(("faults",), "faults.py", 5),
    Run(("headline",), "headline.py --jobs {jobs} --out {out}", 2),
)


def is_of_today(run: Run, history: History) -> bool:
    """Whether none of its tables is older than the code."""
    tables = (ResultTable.load(history.root / FOLDER / f"{name}.json") for name in run.tables)
    return not any(map(history.changed, tables))


def to_do(runs: Sequence[Run], history: History, data: Path | None) -> list[Run]:
    """Runs that are to be made, with a line about each."""
    wanted = []
    for run in runs:
        state = f"about {run.minutes:.0f} min"
        if is_of_today(run, history):
            state = "of today's code"
        elif run.needs_data and data is None:
            state = "left out: no recordings here, say --data DIR"
        else:
            wanted.append(run)
        print(f"{', '.join(run.tables)}: {state}")
    return wanted


def main() -> int:
    asked = arguments(
        __doc__, dry_run=False, jobs=os.cpu_count() or 1, data=Path, out=Path("results-output"), only=[]
    )
    root = Path(__file__).parents[1]
    history, data = History.of(root), asked.data or RECORDINGS
    some = [run for run in RUNS if not asked.only or set(asked.only) & set(run.tables)]
    wanted = to_do(some, history, data)
    print(f"{sum(run.minutes for run in wanted):.0f} min in all", flush=True)
    commit = history.git("rev-parse", "--short", "HEAD").stdout.strip()
    failed = []
    for run in [] if asked.dry_run else wanted:
        words = run.command(asked.jobs, data, asked.out.absolute() / commit)
        print(f"\n{shlex.join(words)}", flush=True)
        (asked.out / commit).mkdir(parents=True, exist_ok=True)
        done = subprocess.run(words, check=False, cwd=root, env=os.environ | {"OPENBLAS_NUM_THREADS": "1"})
        failed += run.tables if done.returncode else ()
    if failed:
        print(f"renew_results: not renewed: {', '.join(failed)}; run again to go on", file=sys.stderr)
    return 1 if failed else 0


if __name__ == "__main__":
    sys.exit(main())
