"""Logs of two places, in one session: whatever ties them is wrong.

    python benchmarks/experiments/slam_strangers.py --data DIR --out DIR [--pairs 24] [--jobs 2] [--save NAME]

DIR as for `slam_walks.py`; each pair is a walk of infcenter and one of the museum. Counted are pairs of windows, one
of each log, closures between them, and those that the graph keeps. Rows stay in the folder of ``--out``; a second run
goes on where the first ended.
"""

import os
from functools import partial
from pathlib import Path

from localize_walks import real_walk
from slam_walks import PLACES

import magmatch as mm
from magmatch_evaluation.saved_table import saver, show
from magmatch_evaluation.script import arguments, kept
from magmatch_evaluation.statistics import wilson_interval

COLUMNS = ("sessions", "window pairs", "closures between", "kept", "95 % bounds of kept a session")


def names(n: int) -> list[str]:
    """Pairs of logs, each place's in turn."""
    ((folder, walks),) = PLACES["infcenter"]
    routes = [f"{place}/{route}" for place, all_of_it in PLACES["museum"] for route in all_of_it]
    # Seven is prime to twenty: other partners each time round.
    return [f"{folder}/{walks[k % len(walks)]} {routes[7 * k % len(routes)]}" for k in range(n)]


def work(name: str, data: Path) -> dict[str, object]:
    session = mm.slam([real_walk(Path(path).name, data)[0] for path in name.split()])
    log = session.graph.log
    between = [c for c in session.graph.closures if log[c.first] != log[c.second]]
    a, b = (len(path.windows) for path in session.paths)
    return {"name": name, "windows": a * b, "between": len(between), "kept": sum(c.is_kept for c in between)}


def main() -> None:
    asked = arguments(__doc__, data=Path, out=Path, pairs=24, jobs=os.cpu_count(), save=saver)
    make = partial(work, data=asked.data)
    found = list(kept(asked.out / "strangers.jsonl", names(asked.pairs), make, jobs=asked.jobs).values())
    sums = {key: sum(row[key] for row in found) for key in ("windows", "between", "kept")}
    low, high = wilson_interval(sum(row["kept"] > 0 for row in found), len(found))
    show(COLUMNS, [[str(len(found)), *map(str, sums.values()), f"{low:.3f} to {high:.3f}"]], asked.save, found)


if __name__ == "__main__":
    main()
