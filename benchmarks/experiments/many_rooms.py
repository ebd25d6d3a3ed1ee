"""Many rooms at every overlap, and very many pairs of different places: rates that six of a kind cannot show.

    python benchmarks/experiments/many_rooms.py --out DIR [--first 8000] [--rooms 40] [--pairs 2000] [--jobs 2]
        [--maps FOLDER] [--minutes M]

Each room (3 x 3 x 0.6 m, 2,500 samples, 0.4 uT of noise) is surveyed twice in frames that are any SE(3), with the
target's region covered to 100, 75, 50, 30 and 15 %; each overlap has rooms of its own. Found: within the tolerance
that the table states. Then maps of different rooms are registered with each other, drawn at random from all made
here and those in ``--maps`` (of `calibrate_probability.py`: other kinds of rooms, areas of a building, robots'
runs, uniform fields); every accepted pair is wrong. Maps and rows stay in DIR, a second run goes on where the
first ended; ``--minutes`` ends each part early, with the table of what there is. Bounds are 95 % (Wilson).
"""

import argparse
import json
import os
import sys
import time
from collections.abc import Iterator
from concurrent.futures import FIRST_COMPLETED, Future, ProcessPoolExecutor, wait
from functools import lru_cache
from itertools import islice, permutations
from pathlib import Path

import numpy as np
from magmatch.evaluation.statistics import wilson_interval
from magmatch.evaluation.trial import nees_of

import magmatch as mm
from magmatch.geometry import transform_error
from magmatch.simulation.config import SimulationConfig

# Overlap: tolerance in m and degrees.
TOLERANCE = {1.0: (0.005, 0.2), 0.75: (0.01, 0.3), 0.5: (0.015, 0.4), 0.3: (0.02, 0.6), 0.15: (0.03, 0.8)}
ROOM = SimulationConfig(room_size=(3.0, 3.0, 0.6))
# Pairs are drawn within blocks of so many maps, so that a worker need not load one for each, nor keep them all.
BLOCK, PAIRS_OF_A_BLOCK = 40, 400
Rows = dict[str, dict[str, object]]


@lru_cache(maxsize=BLOCK)
def load(path: Path) -> mm.FieldMap:
    """A map, kept for the next pair it is in."""
    return mm.FieldMap.load(path)


def map_of(survey: mm.Survey, path: Path) -> mm.FieldMap:
    """Map of a survey, made once."""
    if not path.exists():
        mm.build_map(survey).save(path)
    return load(path)


def same_place(name: str, folder: Path) -> dict[str, object]:
    """Register the two surveys of one room: name is ``overlap-SEED``."""
    percent, seed = map(int, name.split("-"))
    pair = mm.simulate("office-random", seed, ROOM.model_copy(update={"overlap": percent / 100}))
    maps = [map_of(getattr(pair, side), folder / f"{name}.{side}.map") for side in ("base", "target")]
    start = time.process_time()
    result = mm.register(*maps)
    seconds = time.process_time() - start
    best = result.best_pose
    distance, angle = np.inf, np.inf
    if best is not None:
        distance, angle = transform_error(best, pair.T_base_target, pair.target.centroid)
    error = [distance, float(np.degrees(angle)), nees_of(result, pair.T_base_target)]
    return {"name": name, "status": result.status.value, "error": error, "seconds": seconds}


def different_places(name: str) -> dict[str, object]:
    """Register two maps of different places: name is ``BASE / TARGET``."""
    start = time.process_time()
    result = mm.register(*(load(Path(path)) for path in name.split(" / ")))
    seconds = time.process_time() - start
    return {
        "name": name,
        "status": result.status.value,
        "log_odds": result.evidence.get("log_odds"),
        "seconds": seconds,
    }


def work(name: str, folder: Path) -> dict[str, object]:
    """One row."""
    return different_places(name) if " / " in name else same_place(name, folder)


def rooms(first: int, n: int) -> Iterator[str]:
    """Names of pairs of one place, the overlaps in turn."""
    for k in range(n):
        for j, overlap in enumerate(TOLERANCE):
            yield f"{round(100 * overlap)}-{first + len(TOLERANCE) * k + j}"


def crossed(folders: list[Path], n: int, seed: int) -> Iterator[str]:
    """Names of pairs of different places."""
    maps = sorted(path for folder in folders for path in folder.glob("*.map"))
    rng = np.random.default_rng(seed)
    while n:
        block = list(permutations(rng.choice(len(maps), min(BLOCK, len(maps)), replace=False), 2))
        for k in rng.permutation(len(block))[:PAIRS_OF_A_BLOCK]:
            base, target = (maps[side] for side in block[k])
            if site_of(base) != site_of(target) and n:
                n -= 1
                yield f"{base} / {target}"


def site_of(path: Path) -> str:
    """Maps of one site may overlap: rooms of one seed, floors of one building, one motion-capture hall."""
    words = path.name.split(".")[0].split("-")
    return {"aalto": "hall", "jidling": "hall"}.get(words[0], "-".join(words[:2]) if words[0] == "cea" else words[-1])


def run(names: Iterator[str], path: Path, jobs: int, seconds: float, total: int) -> Rows:
    """Rows of all names, those in the file not again; what is in flight at the deadline is finished."""
    known = {r["name"]: r for r in map(json.loads, path.read_text().splitlines())} if path.exists() else {}
    wanted, deadline = list(names), time.monotonic() + seconds
    todo, found = (name for name in wanted if name not in known), {n: known[n] for n in wanted if n in known}
    with ProcessPoolExecutor(jobs) as pool, path.open("a") as stream:
        flying: set[Future[dict[str, object]]] = set()
        while True:
            if time.monotonic() < deadline:
                flying |= {pool.submit(work, name, path.parent) for name in islice(todo, 2 * jobs - len(flying))}
            if not flying:
                return found
            done, flying = wait(flying, return_when=FIRST_COMPLETED)
            for row in (future.result() for future in done):
                stream.write(json.dumps(row) + "\n")
                stream.flush()
                found[str(row["name"])] = row
                if len(found) % 50 == 0:
                    print(f"{len(found)} of {total}", file=sys.stderr)


def report_rooms(found: Rows) -> None:
    """One line per overlap."""
    print("overlap  pairs  accepted within tolerance (95 % bounds)  wrong  refused  mm / deg: median, 95 %  NEES  s")
    for overlap, (max_m, max_deg) in TOLERANCE.items():
        rows = [r for name, r in found.items() if name.startswith(f"{round(100 * overlap)}-")]
        if not rows:
            continue
        distance, angle, nees = np.array([r["error"] for r in rows], dtype=float).T
        accepted = np.array([r["status"] == "accepted" for r in rows])
        good = accepted & (distance < max_m) & (angle < max_deg)
        wrong = accepted & ((distance > 0.1) | (angle > 3))
        low, high = wilson_interval(int(good.sum()), len(rows))
        quantiles = " ".join(
            f"{1e3 * np.quantile(distance, q, method='higher'):7.1f} / {np.quantile(angle, q, method='higher'):.2f}"
            for q in (0.5, 0.95)
        )
        seconds = np.median([r["seconds"] for r in rows])
        print(
            f"{overlap:6.0%} {len(rows):6d}  {good.sum():5d} within {1e3 * max_m:.0f} mm, {max_deg} deg"
            f" ({low:.1%} to {high:.1%}) {wrong.sum():6d} {(~accepted).sum():6d} {quantiles}"
            f" {nees[accepted].mean() if accepted.any() else np.nan:6.2f} {seconds:.2f}"
        )


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--out", type=Path, required=True)
    parser.add_argument("--first", type=int, default=8000)
    parser.add_argument("--rooms", type=int, default=40, help="of each overlap")
    parser.add_argument("--pairs", type=int, default=2000, help="of different places")
    parser.add_argument("--maps", type=Path, action="append", default=[])
    parser.add_argument("--jobs", type=int, default=os.cpu_count())
    parser.add_argument("--minutes", type=float, default=np.inf)
    arguments = parser.parse_args()
    arguments.out.mkdir(parents=True, exist_ok=True)
    seconds = 60 * arguments.minutes
    names = rooms(arguments.first, arguments.rooms)
    found = run(names, arguments.out / "rooms.jsonl", arguments.jobs, seconds, len(TOLERANCE) * arguments.rooms)
    report_rooms(found)
    pairs = crossed([arguments.out, *arguments.maps], arguments.pairs, arguments.first)
    found = run(pairs, arguments.out / "pairs.jsonl", arguments.jobs, seconds, arguments.pairs)
    accepted = [name for name, row in found.items() if row["status"] == "accepted"]
    each = np.median([float(r["seconds"]) for r in found.values()]) if found else np.nan  # type: ignore[arg-type]
    print(f"different places: {len(found)} pairs, {len(accepted)} accepted, {each:.2f} s each")
    for name in accepted:
        print("  ", name, found[name])


if __name__ == "__main__":
    main()
