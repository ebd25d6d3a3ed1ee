"""Walks by dead reckoning, corrected by their field alone: each alone, and those of one place together.

    python benchmarks/experiments/slam_walks.py --data DIR --out DIR [--sets infcenter,museum] [--jobs 2]
        [--save NAME]

DIR holds ``dodolilo/infcenter/walk[1-9].csv`` and ``ipin2023/pdr/route[1-5]_[1-4].csv`` with ``*_truth.csv`` beside
each. Error: rms of positions at the true points after one rigid alignment in the plane, of a walk or of all walks
that share a frame. Settings were chosen on infcenter 1-4 and routes 1-3; those and the others are summed apart.
Rows stay in the folder of ``--out``; a second run goes on where the first ended.
"""

import os
from collections.abc import Iterator
from functools import partial
from pathlib import Path

import numpy as np
from localize_walks import real_walk

import magmatch as mm
from magmatch_evaluation.saved_table import saver, show
from magmatch_evaluation.script import arguments, kept, timed

COLUMNS = ("walks", "tuned on", "m", "odometry, m", "corrected, m", "ratio", "frames", "closures", "s a metre")
SUMS = ("walks", "tuned on", "n", "odometry, rms m", "corrected, rms m", "median ratio", "largest ratio", "frames")
PLACES = {
    "infcenter": [("dodolilo/infcenter", [f"walk{k}" for k in range(1, 10)])],
    "museum": [("ipin2023/pdr", [f"route{r}_{k}" for k in range(1, 5)]) for r in range(1, 6)],
}
TUNED = {*(f"walk{k}" for k in range(1, 5)), *(f"route{r}_{k}" for r in range(1, 4) for k in range(1, 5))}


def names(sets: list[str]) -> Iterator[str]:
    """Each walk alone, then those of one place together: ``FOLDER: WALK WALK ...``."""
    for place in sets:
        for folder, walks in PLACES[place]:
            yield from (f"{folder}: {walk}" for walk in walks)
            yield f"{folder}: {' '.join(walks)}"


def error(found: list[tuple[np.ndarray, np.ndarray]], truths: list[np.ndarray]) -> float:
    """Rms distance of positions (times, (n, 3)) from true points after one rigid alignment, m."""
    a, b = [], []
    for (times, positions), truth in zip(found, truths, strict=True):
        rows = truth[(truth[:, 0] >= times[0]) & (truth[:, 0] <= times[-1])]
        a.append(np.stack([np.interp(rows[:, 0], times, column) for column in positions.T[:2]], axis=1))
        b.append(rows[:, 1:])
    return aligned_rms(*(np.concatenate(parts) for parts in (a, b)))


def aligned_rms(x: np.ndarray, y: np.ndarray, *, is_scaled: bool = False) -> float:
    """Rms distance of points (n, 2) from true ones after one rigid alignment in the plane, or with a scale too, m."""
    x, y = x - x.mean(axis=0), y - y.mean(axis=0)
    U, S, Vt = np.linalg.svd(x.T @ y)
    signs = np.array([1, np.linalg.det(U @ Vt)])
    scale = S @ signs / (x**2).sum() if is_scaled else 1.0
    return float(np.sqrt(((scale * x @ (U * signs) @ Vt - y) ** 2).sum(axis=1).mean()))


def work(name: str, data: Path) -> dict[str, object]:
    logs, truths = zip(*(real_walk(walk, data) for walk in name.split(": ")[1].split()), strict=True)
    session, _, seconds = timed(mm.slam, list(logs))
    before = [error([(log.times, log.positions)], [truth]) for log, truth in zip(logs, truths, strict=True)]
    found = [(log.times, one.positions) for log, one in zip(logs, session.trajectories, strict=True)]
    largest = session.components[0]
    return {
        "name": name, "length": float(sum(path.walked[-1] for path in session.paths)), "before": before,
        "after": error([found[k] for k in largest], [truths[k] for k in largest]),
        "components": [len(c) for c in session.components], "closures": len(session.graph.closures),
        "seconds": seconds,
    }  # fmt: skip


def is_tuned(name: str) -> bool:
    """Whether settings were chosen on any walk of a row."""
    return bool(TUNED & set(name.split(": ")[1].split()))


def main() -> None:
    asked = arguments(__doc__, data=Path, out=Path, sets="infcenter,museum", jobs=os.cpu_count(), save=saver)
    wanted = list(names(asked.sets.split(",")))
    rows = kept(asked.out / "walks.jsonl", wanted, partial(work, data=asked.data), jobs=asked.jobs)
    found = [rows[name] for name in wanted if name in rows]
    table, sums, together = [], [], []
    for row in found:
        before, tuned = float(np.sqrt(np.mean(np.square(row["before"])))), "yes" if is_tuned(row["name"]) else "no"
        errors = f"{before:.2f}", f"{row['after']:.2f}", f"{row['after'] / before:.2f}"
        frames, walks = "+".join(map(str, row["components"])), row["name"].split(": ")[1].split()
        per_metre = f"{row['seconds'] / row['length']:.3f}"
        table.append([row["name"], tuned, f"{row['length']:.0f}", *errors, frames, row["closures"], per_metre])
        if len(walks) > 1:
            together.append([f"{walks[0]} to {walks[-1]} together", tuned, len(walks), *errors, "", frames])
    for place in asked.sets.split(","):
        for tuned in (True, False):
            some = [
                (row["before"][0], row["after"])
                for row in found
                if len(row["before"]) == 1 and is_tuned(row["name"]) == tuned
                and row["name"].split(":")[0] == PLACES[place][0][0]
            ]  # fmt: skip
            if some:
                b, a = np.array(some).T
                rms = [f"{np.sqrt(np.mean(v**2)):.2f}" for v in (b, a)]
                ratios = f"{np.median(a / b):.2f}", f"{(a / b).max():.2f}"
                sums.append([f"{place}, each alone", "yes" if tuned else "no", len(b), *rms, *ratios, ""])
    show(COLUMNS, table)
    show(SUMS, sums + together, asked.save, found)


if __name__ == "__main__":
    main()
