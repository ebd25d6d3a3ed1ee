# SPDX-License-Identifier: BSD-3-Clause
"""Short stretches of one walk through a two-floor building, found in the map of the whole building from another walk.

    python benchmarks/experiments/short_walks.py --out DIR [--from DIR] [--lengths 20 10 5] [--tries 100]
        [--seed 100] [--floors 1 2] [--cut-out] [--jobs 2] [--save NAME]

CEA: base = walk one, both floors; targets = stretches of walk two on either floor, each moved by a random SE(3).
Right = within 0.25 m and 3 deg. With ``--cut-out`` everything within 3 m of the stretch is taken out of the base
(its pairs of points and its known region), so that nothing is right. Prints the counts, the error, the consistency of
the covariance (NEES per degree of freedom) and the seconds per query with the map and its index built. Rows stay in
the folder of ``--out``; a second run goes on where the first ended.
"""

import os
from collections import Counter
from collections.abc import Iterator
from dataclasses import replace
from functools import cache, partial
from itertools import product
from pathlib import Path
from typing import Any

import numpy as np
from scipy.spatial import cKDTree

import magmatch as mm
from magmatch.data.recordings import load_recordings
from magmatch.data.survey import Survey
from magmatch.geometry import path_walked, random_transform, transform_points
from magmatch.registration.clock import Clock
from magmatch.registration.config import PRESETS
from magmatch.registration.index.map_index import MapIndex, index_walks
from magmatch.registration.prepared.prepared_map import prepare
from magmatch.registration.search.pair_search import tabulate_pairs
from magmatch.registration.steps import refine_and_weigh, settle_and_decide
from magmatch.registration.walk_strategy import WalkStrategy
from magmatch_evaluation.saved_table import saver, show
from magmatch_evaluation.script import arguments, in_groups, kept, pose_error, timed
from magmatch_evaluation.trial import nees_of

CONFIG = PRESETS["default"]
MAX_M, MAX_DEG = 0.25, 3.0
# Farther than this from the truth is another place rather than a rough answer.
OTHER_PLACE_M = 1.0


COLUMNS = (
    "floor", "length", "accepted and right", "best pose right", "accepted, out of tolerance", "accepted elsewhere",
    "refused", "median error", "NEES", "s a query", "s a query, one core",
)  # fmt: skip


Row = dict[str, Any]


def stretches(walk: Survey, length: float, n: int, rng: np.random.Generator) -> Iterator[Survey]:
    """Stretches of a given length that start anywhere and have no gap."""
    arc = path_walked(walk.positions)
    found = 0
    while found < n:
        start = arc[rng.integers(len(walk))]
        rows = np.flatnonzero((arc >= start) & (arc <= start + length))
        if arc[rows[-1]] - start < 0.95 * length or np.diff(arc[rows]).max() > 0.3:
            continue
        found += 1
        yield walk.subset(rows)


def cut_out(index: MapIndex, path_model: np.ndarray, radius: float) -> MapIndex:
    """Take the surroundings of a path out of what the base knows."""
    raster, walks = index.base.raster, index.walks
    known = np.argwhere(raster.sd >= 0)
    near = cKDTree(path_model).query(raster.origin + raster.spacing * known, distance_upper_bound=radius)[0] < radius
    values = raster.values.copy()
    values[(*known[near].T, 3)] = -1.0
    base = replace(index.base, raster=raster._replace(values=values))
    table = tabulate_pairs(base, walks.noise.total_sd)
    return MapIndex(base, [replace(walks, base=base, table=table)])


def register_walk(index: MapIndex, target: Survey, seed: int) -> mm.RegistrationResult:
    """Search, refine and decide by pairs of points alone."""
    clock = Clock()
    strategy = WalkStrategy(target, target, CONFIG, seed)
    pair = strategy.pair(index)
    weighed = refine_and_weigh(strategy, pair, strategy.search(pair))
    return settle_and_decide(weighed, CONFIG.decision, clock)


@cache
def building(source: Path | None) -> tuple[dict[str, Survey], MapIndex]:
    """The walks, and walk one as a base."""
    walks, rng = load_recordings("cea", source), np.random.default_rng(0)
    base_map, mapping, _ = timed(mm.build_map, walks["training"])
    walk_index, indexing, _ = timed(lambda: index_walks(prepare(base_map, 8, rng), rng))
    print(
        f"base: {len(walks['training'])} samples, map {mapping:.1f} s, index {indexing:.1f} s "
        f"({len(walk_index.table.first)} pairs of points), field length {walk_index.length:.2f} m\n{walk_index.noise}"
    )
    return walks, MapIndex(walk_index.base, [walk_index])


def try_one(name: str, *, seed: int, source: Path | None, is_cut_out: bool) -> Row:
    """Move a stretch, register it, compare with the truth: name is ``FLOOR LENGTH NUMBER``."""
    walks, index = building(source)
    floor, length, number = name.split()
    rng = np.random.default_rng([seed, int(floor), round(float(length)), int(number)])
    stretch = next(stretches(walks[f"test-floor{floor}"], float(length), 1, rng))
    if is_cut_out:
        index = cut_out(index, transform_points(stretch.positions, index.base.T_map_model.inv()), 3.0)
    T_base_target = random_transform(rng)
    target = stretch.transformed(T_base_target.inv())
    result, *seconds = timed(register_walk, index, target, int(rng.integers(2**32)))
    distance, angle = pose_error(result, T_base_target, target.centroid)
    error = {"metres": distance, "degrees": float(np.degrees(angle)), "nees": nees_of(result, T_base_target)}
    return {"status": result.status.value, "reason": result.reason, "seconds": seconds} | error


def report(floor: int, length: float, rows: list[Row]) -> list[str]:
    """One row; what was accepted though wrong is told aloud."""
    accepted, n = [row for row in rows if row["status"] == "accepted"], len(rows)
    good, elsewhere = [r for r in accepted if is_right(r)], [r for r in accepted if r["metres"] > OTHER_PLACE_M]
    wrong = len(accepted) - len(good) - len(elsewhere)
    refusals = Counter(row["status"] for row in rows if row["status"] != "accepted")
    print(f"floor {floor}, {length:.0f} m: refused {dict(refusals) or 'none'}", flush=True)
    for row in accepted:
        if not is_right(row):
            print(f"    ACCEPTED {row['metres']:.2f} m {row['degrees']:.2f} deg off: {row['reason']}")
    error, consistency = "none", "none"
    if accepted:
        distance, angle = np.median([[1e3 * row["metres"], row["degrees"]] for row in accepted], axis=0)
        error, consistency = f"{distance:.0f} mm, {angle:.2f} deg", f"{np.mean([r['nees'] for r in accepted]):.2f}"
    seconds = [f"{each:.3f}" for each in np.median([row["seconds"] for row in rows], axis=0)]
    counts = [f"{len(good)} of {n}", sum(map(is_right, rows)), wrong, len(elsewhere), n - len(accepted)]
    return [str(floor), f"{length:.0f} m", *map(str, counts), error, consistency, *seconds]


def is_right(row: Row) -> bool:
    """Whether the best pose is within tolerance."""
    return bool(row["metres"] <= MAX_M and row["degrees"] <= MAX_DEG)


def main() -> None:
    asked = arguments(
        __doc__, out=Path, recordings=None, lengths=[20.0, 10.0, 5.0], tries=100, seed=100, floors=[1, 2],
        cut_out=False, jobs=os.cpu_count(), save=saver,
    )  # fmt: skip
    work = partial(try_one, seed=asked.seed, source=asked.recordings, is_cut_out=asked.cut_out)
    kinds = [f"{floor} {length:g}" for floor, length in product(asked.floors, asked.lengths)]
    names = [f"{kind} {k}" for kind in kinds for k in range(asked.tries)]
    found = kept(asked.out / "walks.jsonl", names, work, jobs=asked.jobs)
    rows = [report(int(kind.split()[0]), float(kind.split()[1]), some) for kind, some in in_groups(kinds, found)]
    show(COLUMNS, rows, asked.save, found.values())


if __name__ == "__main__":
    main()
