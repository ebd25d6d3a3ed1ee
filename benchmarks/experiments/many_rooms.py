"""Many rooms at every overlap, or with sources moved, and very many pairs of different places.

    python benchmarks/experiments/many_rooms.py --out DIR [--first 8000] [--rooms 40] [--pairs 2000] [--jobs 2]
        [--maps FOLDER ...] [--minutes M] [--save NAME] [--save-pairs NAME]

Each room (3 x 3 x 0.6 m, 2,500 samples, 0.4 uT of noise) is surveyed twice in frames that are any SE(3), with the
target's region covered to 100, 75, 50, 30 and 15 %; in others, of the default size, 10, 20 or 40 % of the sources
stand elsewhere in the second survey. Each condition has rooms of its own. Found: within the tolerance that the table
states. Then maps of different rooms are registered with each other, drawn at random from all made
here and those in ``--maps`` (of `fit_decision.py`: other kinds of rooms, areas of a building, robots'
runs, uniform fields); every accepted pair is wrong. Maps and rows stay in DIR, a second run goes on where the
first ended; ``--minutes`` ends each part early, with the table of what there is. Bounds are 95 % (Wilson).
"""

import os
from collections import Counter
from collections.abc import Iterator
from dataclasses import dataclass
from functools import lru_cache, partial
from itertools import permutations
from pathlib import Path

import numpy as np

import magmatch as mm
from magmatch.field.config import SPLINE
from magmatch.simulation.config import SimulationConfig
from magmatch.simulation.scene import SimulatedPair
from magmatch_evaluation.saved_table import saver, show
from magmatch_evaluation.script import arguments, kept, pose_error, timed
from magmatch_evaluation.statistics import wilson_interval
from magmatch_evaluation.trial import nees_of


@dataclass(frozen=True)
class Condition:
    """What the rooms of a row have in common."""

    title: str
    tolerance: tuple[float, float]  # m and degrees
    settings: dict[str, object]


def covered(overlap: float, *tolerance: float) -> Condition:
    size = {"room_size": (3.0, 3.0, 0.6)}
    return Condition(f"{overlap:.0%} overlap", tolerance, size | {"overlap": overlap})


def moved(share: float) -> Condition:
    return Condition(f"{share:.0%} of sources moved", (0.1, 3.0), {"moved_sources": share})


# By the words before the seed in the name of a pair.
CONDITIONS = {
    "100": covered(1.0, 0.005, 0.2),
    "75": covered(0.75, 0.01, 0.3),
    "50": covered(0.5, 0.015, 0.4),
    "30": covered(0.3, 0.02, 0.6),
    "15": covered(0.15, 0.03, 0.8),
    "moved10": moved(0.1),
    "moved20": moved(0.2),
    "moved40": moved(0.4),
}
ROOM_COLUMNS = (
    "rooms", "accepted within tolerance", "95 % bounds", "accepted, wrong", "refused",
    "median", "95 %", "NEES", "s a pair",
)  # fmt: skip
# Why pairs of different places are refused, and evidence that is remarkable there, in nats.
STATUSES = ("accepted", "inconsistent", "uninformative", "ambiguous", "no_overlap", "degenerate")
NATS = (15, 50)
PAIR_COLUMNS = (
    "drawing", "pairs", *(s.replace("_", " ") for s in STATUSES), *(f"above {nats} nats" for nats in NATS)
)  # fmt: skip
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
        mm.build_map(survey, SPLINE).save(path)
    return load(path)


def room(name: str) -> SimulatedPair:
    """The two surveys of a room: name is ``CONDITION-SEED``."""
    condition, seed = name.split("-")
    settings = SimulationConfig.model_validate(CONDITIONS[condition].settings)
    return mm.simulate("office-random", int(seed), settings)


def same_place(name: str, folder: Path) -> dict[str, object]:
    """Register the two surveys of one room."""
    pair = room(name)
    maps = [map_of(getattr(pair, side), folder / f"{name}.{side}.map") for side in ("base", "target")]
    result, _, seconds = timed(mm.register, *maps)
    distance, angle = pose_error(result, pair.T_base_target, pair.target.centroid)
    error = [distance, float(np.degrees(angle)), nees_of(result, pair.T_base_target)]
    return {"name": name, "status": result.status.value, "error": error, "seconds": seconds}


def different_places(name: str) -> dict[str, object]:
    """Register two maps of different places: name is ``BASE / TARGET``."""
    result, _, seconds = timed(mm.register, *(load(Path(path)) for path in name.split(" / ")))
    odds = result.evidence.get("log_odds")
    return {"name": name, "status": result.status.value, "log_odds": odds, "seconds": seconds}


def work(folder: Path, name: str) -> dict[str, object]:
    return different_places(name) if " / " in name else same_place(name, folder)


def rooms(first: int, n: int) -> Iterator[str]:
    """Names of pairs of one place, the conditions in turn."""
    for k in range(n):
        for j, condition in enumerate(CONDITIONS):
            yield f"{condition}-{first + len(CONDITIONS) * k + j}"


def crossed(folders: list[Path], n: int, seed: int) -> Iterator[str]:
    """Names of pairs of different places."""
    maps = sorted(path for folder in folders for path in folder.glob("*.map"))
    rng = np.random.default_rng(seed)
    while n:
        block = list(permutations(rng.choice(len(maps), min(BLOCK, len(maps)), replace=False), 2))
        for k in rng.permutation(len(block))[:PAIRS_OF_A_BLOCK]:
            base, target = (maps[side] for side in block[k])
            if site_of(base.name) != site_of(target.name) and n:
                n -= 1
                yield f"{base} / {target}"


def site_of(name: str) -> str:
    """Maps of one site may overlap: rooms of one seed, floors of one building, one motion-capture hall."""
    words = name.split(".", maxsplit=1)[0].split("-")
    return {"aalto": "hall", "jidling": "hall"}.get(words[0], "-".join(words[:2]) if words[0] == "cea" else words[-1])


def table_of_rooms(found: Rows) -> list[list[str]]:
    lines = []
    for word, condition in CONDITIONS.items():
        max_m, max_deg = condition.tolerance
        rows = [r for name, r in found.items() if name.startswith(f"{word}-")]
        if not rows:
            continue
        distance, angle, nees = np.array([r["error"] for r in rows], dtype=float).T
        accepted = np.array([r["status"] == "accepted" for r in rows])
        good = accepted & (distance < max_m) & (angle < max_deg)
        wrong = accepted & ((distance > 0.1) | (angle > 3))
        low, high = wilson_interval(int(good.sum()), len(rows))
        errors = np.quantile([1e3 * distance, angle], (0.5, 0.95), axis=1, method="higher")
        lines.append([
            condition.title, f"{good.sum():,} of {len(rows):,} within {1e3 * max_m:.0f} mm, {max_deg:g} deg",
            f"{low:.1%} to {high:.1%}", f"{wrong.sum()}", f"{(~accepted).sum()}",
            *(f"{mm:.1f} mm, {deg:.2f} deg" for mm, deg in errors),
            f"{nees[accepted].mean() if accepted.any() else np.nan:.2f}",
            f"{np.median([r['seconds'] for r in rows]):.2f}",
        ])  # fmt: skip
    return lines


def table_of_pairs(found: Rows) -> list[list[str]]:
    """How many pairs of different places were accepted, and why the others were refused."""
    reasons = Counter(str(row["status"]) for row in found.values())
    evidence = np.array([-np.inf if row["log_odds"] is None else row["log_odds"] for row in found.values()])
    counts = [len(found), *(reasons[status] for status in STATUSES), *((evidence > nats).sum() for nats in NATS)]
    return [["together", *(f"{count:,}" for count in counts)]]


def main() -> None:
    asked = arguments(
        __doc__, out=Path, first=8000, rooms=40, pairs=2000, maps=[], jobs=os.cpu_count(), minutes=np.inf,
        save=saver, save_pairs=saver,
    )  # fmt: skip
    make, how = partial(work, asked.out), {"jobs": asked.jobs, "minutes": asked.minutes}
    found = kept(asked.out / "rooms.jsonl", rooms(asked.first, asked.rooms), make, **how)
    show(ROOM_COLUMNS, table_of_rooms(found), asked.save, found.values())
    names = crossed([asked.out, *map(Path, asked.maps)], asked.pairs, asked.first)
    found = kept(asked.out / "pairs.jsonl", names, make, **how)
    accepted = [name for name, row in found.items() if row["status"] == "accepted"]
    each = np.median([float(r["seconds"]) for r in found.values()]) if found else np.nan  # type: ignore[arg-type]
    show(PAIR_COLUMNS, table_of_pairs(found), asked.save_pairs, found.values())
    print(f"{each:.2f} s each")
    for name in accepted:
        print("  ", name, found[name])


if __name__ == "__main__":
    main()
