"""Surveys in lanes beside each other that never meet: whatever closes there pulls one lane onto the next.

    python benchmarks/experiments/slam_lanes.py --data DIR --out DIR [--first 800] [--seeds 12] [--jobs 2]
        [--minutes N] [--save NAME]

hall: the simulated hall of `slam_scenarios.py` in lanes 1.5 m apart. floor: a phone's survey of a building's floor
(``kaist``, points 0.6 m apart, interpolated by thin-plate splines), walked along its aisles in lanes 1.2 to 3 m
apart, moved by up to 0.3 m. robot: Aalto's runs 1 and 2 of both sensors, which are lanes. Odometry of 0.5, 1 and 3 %
as there; slam is told nothing of it. Worse: rms of places, after one rigid alignment in the plane, over 1.1 of
odometry's. Wrong as there. Rows stay in the folder of ``--out``; a second run goes on where the first ended.
"""

import os
from functools import cache, partial
from pathlib import Path

import numpy as np
from scipy.interpolate import RBFInterpolator
from slam_scenarios import DRIFTS, PLACES, at_nodes, drifted, off_truth, place, survivors
from slam_walks import aligned_rms

import magmatch as mm
from magmatch.data.recordings import load_recordings
from magmatch.geometry import path_walked
from magmatch.simulation.paths import resample
from magmatch_evaluation.saved_table import saver, show
from magmatch_evaluation.script import arguments, in_groups, kept

COLUMNS = (
    "place", "lanes apart, m", "drift, %", "n", "field lengths apart", "odometry, m", "closures", "wrong",
    "wrong that survive", "worse than odometry", "largest ratio",
)  # fmt: skip
WORSE = 1.1
# Lanes of each place, m apart; the robot's are as it drove.
LANES = {"hall": (1.5,), "floor": (1.2, 1.8, 3.0), "robot": (0.8,)}
# Of the floor: the aisles' corner and size; m between samples, and how far a survey of it may be moved.
CORNER, SIZE, STEP, MOVED = (33.0, 8.0), (14.0, 36.0), 0.07, 0.3
RUNS = ("invensense-1", "invensense-2", "trivisio-1", "trivisio-2")
# m between samples of a robot that also stands.
DRIVEN = 0.02


@cache
def floor_field(data: Path) -> RBFInterpolator:
    """The field of the floor, T, at any (n, 2) of it."""
    (survey,) = load_recordings("kaist", data / "kaist").values()
    _, rows = np.unique(np.round(survey.positions[:, :2], 1), axis=0, return_index=True)
    return RBFInterpolator(survey.positions[rows, :2], survey.field[rows], neighbors=40, kernel="thin_plate_spline")


robot_runs = cache(partial(load_recordings, "aalto"))


def lanes(name: str, apart: float, seed: int, data: Path, rng: np.random.Generator) -> tuple[np.ndarray, np.ndarray]:
    """True path (n, 3) and its field, T."""
    if name == "hall":
        return place("hall", 1, rng)
    if name == "robot":
        run = robot_runs(data / "aalto")[RUNS[seed % len(RUNS)]]
        rows = np.unique((path_walked(run.positions) / DRIVEN).astype(np.int64), return_index=True)[1]
        return run.positions[rows], run.field[rows]
    columns = np.arange(CORNER[0], CORNER[0] + SIZE[0] + apart / 2, apart)
    ends = CORNER[1] + SIZE[1] * np.array([[0, 1], [1, 0]])
    corners = np.array([(x, y, 0.0) for k, x in enumerate(columns) for y in ends[k % 2]])
    moved = np.array([*rng.uniform(-MOVED, MOVED, 2), 0.0])
    path = resample(corners, int(path_walked(corners)[-1] / STEP)) + moved
    return path, floor_field(data)(path[:, :2])


def work(name: str, data: Path) -> dict[str, object]:
    kind, apart, percent, seed = name.split(" ")
    # The hall's are the logs of `slam_scenarios.py`.
    rng = np.random.default_rng([PLACES.index("hall") if kind == "hall" else int(10 * float(apart)), int(seed)])
    path, field = lanes(kind, float(apart), int(seed), data, rng)
    log = drifted(path, field, float(percent), rng)
    session = mm.slam(log)
    p, turned = at_nodes(session, path)
    wrong, survive = survivors(session, off_truth(session, p, turned))
    before, after = (aligned_rms(s.positions[:, :2], path[:, :2]) for s in (log, session.trajectories[0]))
    return {
        "name": name, "before": before, "after": after, "field_length": session.paths[0].windows[0].length,
        "closures": len(session.graph.closures), "wrong": wrong, "survive": survive,
    }  # fmt: skip


def main() -> None:
    asked = arguments(
        __doc__, data=Path, out=Path, first=800, seeds=12, jobs=os.cpu_count(), minutes=np.inf, save=saver
    )
    seeds = range(asked.first, asked.first + asked.seeds)
    groups = [f"{kind} {apart} {percent}" for kind, some in LANES.items() for apart in some for percent in DRIFTS]
    wanted = [f"{group} {seed}" for seed in seeds for group in groups]
    make = partial(work, data=asked.data)
    rows = kept(asked.out / "lanes.jsonl", wanted, make, jobs=asked.jobs, minutes=asked.minutes)
    table = []
    for group, some in in_groups(groups, rows):
        before, after, length = (np.array([r[key] for r in some]) for key in ("before", "after", "field_length"))
        sums = [sum(r[key] for r in some) for key in ("closures", "wrong", "survive")]
        table.append([
            *group.split(" "), len(some), f"{np.median(float(group.split(' ')[1]) / length):.1f}",
            f"{np.median(before):.3f}", *sums, int((after > WORSE * before).sum()), f"{(after / before).max():.2f}",
        ])  # fmt: skip
    show(COLUMNS, table, asked.save, rows.values())


if __name__ == "__main__":
    main()
