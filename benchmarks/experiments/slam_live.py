"""Logs that are corrected while they are walked: how far the poses are off as they are said, and at what speed.

    python benchmarks/experiments/slam_live.py --data DIR --out DIR [--first 800] [--seeds 4] [--jobs 2]
        [--sets corridor,office,hall,table,infcenter,museum] [--save NAME]

Simulated logs are those of ``slam_scenarios.py``, passed three times with 1 % of drift, at 1 m/s (over the table 0.1
m/s); recordings those of ``slam_walks.py``. Each is fed sample by sample. Errors are rms after one rigid alignment in
the plane: of odometry, of poses as they were said when their sample came, of the whole path as known at the end, and
after ``finish``, which gives what ``slam`` gives. Speed: time walked over time of the processor, of the whole log and
of its last tenth, and the longest that a sample had to wait. Rows stay in DIR; a second run goes on where the first
ended.
"""

import os
from collections.abc import Iterator
from dataclasses import replace
from functools import partial
from pathlib import Path
from time import process_time

import numpy as np
import slam_scenarios
from localize_walks import real_walk
from scipy.spatial.transform import RigidTransform
from slam_walks import PLACES, error

import magmatch as mm
from magmatch_evaluation.saved_table import saver, show
from magmatch_evaluation.script import arguments, kept

COLUMNS = (
    "logs", "n", "odometry, rms m", "as said", "at the end", "finished", "median ratio at the end", "largest",
    "times real time, median", "least", "of the last tenth, least", "longest wait, s",
)  # fmt: skip
PASSES, DRIFT = 3, 1.0
# m/s, where it is not one.
SPEEDS = {"table": 0.1}


def names(sets: list[str], seeds: range) -> Iterator[str]:
    """``SET LOG``, a seed or a walk each."""
    for one in sets:
        logs = [walk for _, walks in PLACES[one] for walk in walks] if one in PLACES else map(str, seeds)
        yield from (f"{one} {log}" for log in logs)


def simulated(place: str, seed: int) -> tuple[mm.Survey, np.ndarray]:
    """A log, and its true path."""
    rng = np.random.default_rng([seed, PASSES, slam_scenarios.PLACES.index(place)])
    path, field = slam_scenarios.place(place, PASSES, rng)
    log = slam_scenarios.drifted(path, field, DRIFT, rng)
    assert log.times is not None
    return replace(log, times=log.times / SPEEDS.get(place, 1.0)), path


def work(name: str, data: Path) -> dict[str, object]:
    one, log_name = name.split()
    if one in PLACES:
        log, truth = real_walk(log_name, data)
    else:
        log, path = simulated(one, int(log_name))
        truth = np.column_stack([log.times, path[:, :2]])
    session, said, spent = mm.Session(), [], []
    for k in range(len(log)):
        T = RigidTransform.from_components(log.positions[k], log.orientations[k])
        b = log.orientations[k].inv().apply(log.field[k])
        start = process_time()
        session.add(float(log.times[k]), T, b)
        said.append(session.pose().translation)
        spent.append(process_time() - start)
    known = session.trajectories[0].positions
    # What is not in a window yet stays as it was said.
    last, said, waited = np.array(said)[len(known) :], np.array(said), np.array(spent)
    n_closures = len(session.graph.closures)
    session.finish(log.name)
    places = (log.positions, said, np.concatenate([known, last]), session.trajectories[0].positions)
    tenth = len(log) // 10
    return {
        "name": name, "errors": [error([(log.times, p)], [truth]) for p in places], "closures": n_closures,
        "walked": float(log.times[-1] - log.times[0]), "seconds": float(waited.sum()),
        "last_tenth": [float(log.times[-1] - log.times[-tenth]), float(waited[-tenth:].sum())],
        "longest": float(waited.max()),
    }  # fmt: skip


def main() -> None:
    asked = arguments(
        __doc__, data=Path, out=Path, sets="corridor,office,hall,table,infcenter,museum", first=800, seeds=4,
        jobs=os.cpu_count(), save=saver,
    )  # fmt: skip
    sets = asked.sets.split(",")
    wanted = list(names(sets, range(asked.first, asked.first + asked.seeds)))
    mm.slam(simulated("table", 0)[0])  # loops are compiled
    rows = kept(asked.out / "live.jsonl", wanted, partial(work, data=asked.data), jobs=asked.jobs)
    table = []
    for one in sets:
        some = [row for name, row in rows.items() if name.split()[0] == one]
        if not some:
            continue
        errors = np.array([row["errors"] for row in some])
        times = np.array([row["walked"] / row["seconds"] for row in some])
        late = min(row["last_tenth"][0] / max(row["last_tenth"][1], 1e-9) for row in some)
        ratios = errors[:, 2] / errors[:, 0]
        table.append([
            one, len(some), *(f"{e:.2f}" for e in np.sqrt((errors**2).mean(axis=0))), f"{np.median(ratios):.2f}",
            f"{ratios.max():.2f}", f"{np.median(times):.0f}", f"{times.min():.0f}", f"{late:.0f}",
            f"{max(row['longest'] for row in some):.1f}",
        ])  # fmt: skip
    show(COLUMNS, table, asked.save, list(rows.values()))


if __name__ == "__main__":
    main()
