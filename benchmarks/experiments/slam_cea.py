"""Two walks through each floor of a building, their field real and their odometry made up, corrected together.

    python benchmarks/experiments/slam_cea.py --data DIR --out DIR [--seeds 5] [--jobs 2] [--minutes N] [--save NAME]

DIR holds ``cea/corridor_*.csv``, true places with the field there. Drift of d %: a random walk of place whose end
is d % of the path off (rms), so rough that windows bend, and of heading of d deg over 10 m; slam is told. Errors:
rms of places after one rigid alignment in the plane, of odometry each walk by itself, of the result both walks at
once. Ratio: of the two. Wrong: off by more than half a field length and three standard deviations. NEES is of nodes
in the frame of the first, per degree of freedom. Settings were chosen on floor 1. Rows stay in the folder of
``--out``; a second run goes on where the first ended.
"""

import os
from dataclasses import replace
from functools import partial
from pathlib import Path

import numpy as np
from scipy.spatial.transform import RigidTransform, Rotation
from slam_scenarios import NOISE, at_nodes, nees_of, off_truth, survivors
from slam_walks import aligned_rms

import magmatch as mm
from magmatch.geometry import path_walked
from magmatch.preparation.odometry.drift import OdometryConfig
from magmatch.simulation.paths import heading_along, upright
from magmatch_evaluation.saved_table import saver, show
from magmatch_evaluation.script import arguments, in_groups, kept, timed

COLUMNS = (
    "floor", "drift, %", "n", "in one frame", "odometry, m", "corrected, m", "median ratio", "NEES", "closures",
    "wrong", "wrong that survive", "kept, over 1 m off", "s a metre",
)  # fmt: skip
FLOORS, DRIFTS, WALKS = (1, 2), (1.0, 3.0), ("training", "test")
# Height between the floors, m, and distance beyond which a kept closure is counted, whatever it states.
BETWEEN, FAR = 4.5, 1.0


def drifted(path: np.ndarray, field: np.ndarray, percent: float, rng: np.random.Generator) -> mm.Survey:
    """The log of a body that looks ahead and knows its path from drifting odometry, in the frame of its start."""
    steps = np.diff(path, axis=0)
    length = np.linalg.norm(steps, axis=1)
    total = length.sum()
    ahead = heading_along(path)
    turned = np.concatenate(
        [[0], np.cumsum(np.radians(percent) * np.sqrt(length / 10) * rng.standard_normal(len(length)))]
    )
    moved = np.zeros_like(steps)
    moved[:, :2] = percent / 100 * np.sqrt(total * length / 2)[:, None] * rng.standard_normal((len(length), 2))
    steps = upright(turned[:-1]).apply(steps) + moved
    positions = np.concatenate([np.zeros((1, 3)), np.cumsum(steps, axis=0)])
    measured = field + NOISE * rng.standard_normal(field.shape)
    sensor = upright(ahead + turned)
    wrong = mm.Survey(
        positions, upright(turned).apply(measured), times=path_walked(path), orientations=sensor, name="walk.csv"
    )
    return wrong.transformed(RigidTransform.from_rotation(Rotation.from_euler("z", rng.uniform(-np.pi, np.pi))))


def told(path: np.ndarray, percent: float) -> tuple[float, float]:
    """Drift as the maker of the odometry states it: of 10 m, per axis."""
    return percent / 100 * float(np.sqrt(path_walked(path)[-1] * 10 / 2)), percent


def work(name: str, data: Path) -> dict[str, object]:
    """Both walks of a floor with one drift and seed: ``FLOOR PERCENT SEED``."""
    floor, percent, seed = map(float, name.split(" "))
    rng, logs, paths, states = np.random.default_rng([int(floor), int(seed)]), [], [], {}
    for walk in WALKS:
        rows = np.loadtxt(data / "cea" / f"corridor_{walk}.csv", delimiter=",")
        rows = rows[(rows[:, 2] < BETWEEN) == (floor == 1)]
        # One height: what a walker on a floor knows.
        paths.append(rows[:, :3] * [1, 1, 0])
        logs.append(replace(drifted(paths[-1], rows[:, 3:] * 1e-6, percent, rng), name=f"{walk}.csv"))
        states[logs[-1].name] = told(paths[-1], percent)
    config = mm.SlamConfig(odometry=OdometryConfig(sd=states["test.csv"]), sd_of_logs=states)
    session, seconds, _ = timed(mm.slam, logs, config)
    p, turned = at_nodes(session, *paths)
    off, group = off_truth(session, p, turned), session.components[0]
    after = aligned_rms(
        *(
            np.concatenate([some[k][:, :2] for k in group])
            for some in ([t.positions for t in session.trajectories], paths)
        )
    )
    wrong, survive = survivors(session, off)
    before = [aligned_rms(log.positions[:, :2], path[:, :2]) for log, path in zip(logs, paths, strict=True)]
    return {
        "name": name, "together": len(group) == len(logs), "before": float(np.sqrt(np.mean(np.square(before)))),
        "after": after, "nees": nees_of(session, p, turned), "closures": len(off),
        "wrong": wrong, "survive": survive,
        "far": sum(bool(c.is_kept) for c, apart in zip(session.graph.closures, off, strict=True) if apart > FAR),
        "seconds": seconds, "length": float(sum(one.walked[-1] for one in session.paths)),
    }  # fmt: skip


def main() -> None:
    asked = arguments(__doc__, data=Path, out=Path, seeds=5, jobs=os.cpu_count(), minutes=np.inf, save=saver)
    groups = [f"{floor} {percent}" for percent in DRIFTS for floor in FLOORS]
    wanted = [f"{group} {seed}" for seed in range(asked.seeds) for group in groups]
    make = partial(work, data=asked.data)
    rows = kept(asked.out / "cea.jsonl", wanted, make, jobs=asked.jobs, minutes=asked.minutes)
    table = []
    for group, some in in_groups(groups, rows):
        before, after = (np.array([row[key] for row in some]) for key in ("before", "after"))
        counted = ("closures", "wrong", "survive", "far")
        sums = {key: sum(row[key] for row in some) for key in (*counted, "together", "seconds", "length")}
        table.append([
            *group.split(" "), str(len(some)), str(sums["together"]), f"{np.median(before):.2f}",
            f"{np.median(after):.2f}", f"{np.median(after / before):.2f}",
            f"{np.median([row['nees'] for row in some]):.2f}", *(str(sums[key]) for key in counted),
            f"{sums['seconds'] / sums['length']:.3f}",
        ])  # fmt: skip
    show(COLUMNS, table, asked.save, rows.values())


if __name__ == "__main__":
    main()
