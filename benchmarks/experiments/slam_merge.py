"""Surveys of a hall, each in a frame of its own, merged with a stranger among them: who is tied, and how well.

    python benchmarks/experiments/slam_merge.py --out DIR [--first 100] [--seeds 20] [--jobs 2]
        [--minutes N] [--save NAME]

A hall 3 m wide; surveys of 3 x 3 x 0.6 m (800 samples, 0.4 uT of noise, any SE(3)) lie 1 to 2.2 m apart along it:
each overlaps its neighbours by a quarter to two thirds, none overlaps all. One more survey is of another hall. Tied:
pairs that overlap by 20 % or more and share a frame. Against direct: error of a pair at the target's centroid over
that of its own registration, where there is one. NEES per degree of freedom, of pairs without a registration. Wrong:
a kept closure with the stranger, or more than half a metre off. Rows stay in DIR; a second run goes on where the
first ended.
"""

import os
from itertools import combinations
from pathlib import Path

import numpy as np
from scipy.spatial.transform import RigidTransform

import magmatch as mm
from magmatch.geometry import random_transform, transform_error
from magmatch.simulation.config import SimulationConfig
from magmatch.simulation.magnets import field_of
from magmatch.simulation.structures import around_box, calibrated
from magmatch_evaluation.saved_table import saver, show
from magmatch_evaluation.script import arguments, kept, timed
from magmatch_evaluation.statistics import wilson_interval

SURVEYS, SIDE, HEIGHT = (3, 5, 10), 3.0, 0.6
N_SAMPLES, NOISE, OVERLAP, FAR = 800, 4e-7, 0.2, 0.5
EARTH = np.array(SimulationConfig().earth_field)
COLUMNS = (
    "surveys", "n", "pairs of 20 % tied", "against direct, median", "NEES of other pairs", "sessions tied wrongly",
    "95 % bounds", "s a pair",
)  # fmt: skip


def surveyed(
    begins: list[float], rng: np.random.Generator, name: str
) -> tuple[list[mm.Survey], list[RigidTransform]]:
    """Surveys of one hall, and the frame of each from the hall's."""
    low, high = np.array([min(begins), 0.0, 0.0]), np.array([max(begins) + SIDE, SIDE, HEIGHT])
    # As many structures a metre as a room has.
    sources = around_box(low, high, 0.3, rng)
    sources = calibrated(sources, rng.uniform(low, high, (300, 3)), 6e-6)
    surveys, frames = [], []
    for k, begin in enumerate(begins):
        p = rng.uniform([begin, 0.0, 0.0], [begin + SIDE, SIDE, HEIGHT], (N_SAMPLES, 3))
        b = field_of(sources, p) + EARTH + NOISE * rng.standard_normal(p.shape)
        frames.append(random_transform(rng, 10.0))
        surveys.append(mm.Survey(p, b, name=f"{name}{k}.csv").transformed(frames[-1]))
    return surveys, frames


def work(name: str) -> dict[str, object]:
    n, seed = map(int, name.split(" "))
    rng = np.random.default_rng([n, seed])
    begins = np.concatenate([[0.0], np.cumsum(rng.uniform(1.0, 2.2, n - 1))])
    surveys, frames = surveyed(begins.tolist(), rng, "part")
    strangers, _ = surveyed([0.0], rng, "stranger")
    session, seconds, _ = timed(mm.merge, surveys + strangers)
    graph, component = session.graph, session.component_of
    direct = {(c.first, c.second): c for c in session.graph.closures}
    true = {(a, b): between_centroids(a, b, surveys, frames) for a, b in combinations(range(n), 2)}
    tied, against, nees = [], [], []
    for (a, b), T in true.items():
        merged = graph.pose(a).inv() * graph.pose(b)
        is_tied = component[a] == component[b]
        if begins[b] - begins[a] <= (1 - OVERLAP) * SIDE:
            tied.append(is_tied)
        if not is_tied:
            continue
        if (a, b) in direct:
            against.append(off(merged, T) / off(direct[a, b].T_first_second, T))
        else:
            xi = (merged.inv() * T).as_exp_coords()
            nees.append(float(xi @ np.linalg.solve(graph.relative_covariances(np.array([a]), b)[0], xi)) / 6)
    wrong = sum(
        c.is_kept and (c.second == n or off(c.T_first_second, true[c.first, c.second]) > FAR) for c in graph.closures
    )
    return {
        "name": name, "tied": [int(t) for t in tied], "against": against, "nees": nees, "wrong": int(wrong),
        "seconds": seconds / (n * (n + 1) / 2),
    }  # fmt: skip


def between_centroids(a: int, b: int, surveys: list[mm.Survey], frames: list[RigidTransform]) -> RigidTransform:
    """True pose of a survey's centroid about another's."""
    T = frames[a] * frames[b].inv() * RigidTransform.from_translation(surveys[b].centroid)
    return RigidTransform.from_translation(-surveys[a].centroid) * T


def off(T: RigidTransform, T_true: RigidTransform) -> float:
    """Distance of a centroid from where it is, m."""
    return transform_error(T, T_true, np.zeros(3))[0]


def main() -> None:
    asked = arguments(__doc__, out=Path, first=100, seeds=20, jobs=os.cpu_count(), minutes=np.inf, save=saver)
    seeds = range(asked.first, asked.first + asked.seeds)
    wanted = [f"{n} {seed}" for seed in seeds for n in SURVEYS]
    rows = kept(asked.out / "merge.jsonl", wanted, work, jobs=asked.jobs, minutes=asked.minutes)
    table = []
    for n in SURVEYS:
        some = [row for name, row in rows.items() if name.split(" ")[0] == str(n)]
        if not some:
            continue
        tied, against, nees = ([x for row in some for x in row[key]] for key in ("tied", "against", "nees"))
        wrong = sum(row["wrong"] > 0 for row in some)
        low, high = wilson_interval(wrong, len(some))
        table.append([
            str(n), str(len(some)), f"{sum(tied)} of {len(tied)}", f"{np.median(against):.2f}" if against else "",
            f"{np.mean(nees):.2f}" if nees else "", str(wrong), f"{low:.3f} to {high:.3f}",
            f"{np.mean([row['seconds'] for row in some]):.1f}",
        ])  # fmt: skip
    show(COLUMNS, table, asked.save, rows.values())


if __name__ == "__main__":
    main()
