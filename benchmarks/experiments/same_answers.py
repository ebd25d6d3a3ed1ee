# SPDX-License-Identifier: BSD-3-Clause
"""Whether a change of the code changed an answer: a fixed list of pairs, registered before and after.

    python benchmarks/experiments/same_answers.py make PAIRS [--from DIR]     surveys of all pairs, once
    python benchmarks/experiments/same_answers.py run PAIRS ANSWERS.jsonl [--like TEXT] [--jobs N]
    python benchmarks/experiments/same_answers.py compare BEFORE.jsonl AFTER.jsonl

Rooms of each overlap, other places, walks, tables, corridors, planes, moved sources, corrupted sensors, recordings,
the published method. Numbers are kept as hexadecimal floats: equal means equal to the bit. A second run goes on where
the first ended. ``--like TEXT`` takes the pairs whose name holds it.
"""

import json
import sys
import time
from collections.abc import Callable, Iterator
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from scipy.spatial.transform import Rotation

import magmatch as mm
from magmatch_evaluation.script import arguments, kept

ROOM = {"room_size": (3.0, 3.0, 0.6), "n_samples": 1500}
# Statements that do not depend on the clock, the version or the settings' names.
KEYS = (
    "status", "reason", "T_base_target", "covariance", "probability", "evidence", "overlap", "alternatives",
    "degenerate_directions", "sensor", "residual", "fitness", "inliers", "keypoints", "correspondences", "links",
)  # fmt: skip

# Pairs that the published method is asked for, too.
OF_PAPER = {"room-1-0", "room-0.5-1", "nowhere-0", "table-0", "z30-0", "x30-1"}


def simulated() -> Iterator[tuple[str, str, int, dict[str, Any]]]:
    """Name, scenario, seed and settings of every simulated pair."""
    for overlap in (1.0, 0.75, 0.5, 0.3, 0.15):
        for seed in range(8):
            yield f"room-{overlap:g}-{seed}", "office-random", 500 + seed, {**ROOM, "overlap": overlap}
    for seed in range(8):
        yield f"nowhere-{seed}", "nowhere", 600 + seed, {"n_samples": 1000}
    for name, scenario, n in (
        ("uniform", "uniform", 2), ("repeated", "repeated", 2), ("table", "table", 4), ("robot", "table-robot", 4),
        ("corridor", "corridor", 4), ("inside", "office-inside", 3), ("z30", "office-z30", 2),
        ("x30", "office-x30", 2), ("hand-held", "office-hand-held", 2),
    ):  # fmt: skip
        for seed in range(n):
            yield f"{name}-{seed}", scenario, 700 + seed, {"n_samples": 1200}
    for share in (0.1, 0.2, 0.4):
        for seed in range(3):
            yield f"moved-{share:g}-{seed}", "office-random", 800 + seed, {"n_samples": 1200, "moved_sources": share}
    for gap in (0.0, 0.2, 0.4):
        yield f"planes-{gap:g}", "planar", 900, {"n_samples": 1200, "plane_gap": gap}
    for drift in (0.05, 0.1):
        yield f"drift-{drift:g}", "corridor", 901, {"n_samples": 1200, "pose_drift": drift}
    for noise in (3e-6, 1e-5):
        yield f"noise-{noise:g}", "office-random", 902, {"n_samples": 800, "noise_sd": noise}
    for n in (100, 300):
        yield f"few-{n}", "office-random", 903, {"n_samples": n}
    for bias in (2e-6, 5e-6):
        yield f"bias-{bias:g}", "office-random", 904, {"n_samples": 800, "bias": (bias, -bias, bias), "scale": 0.03}


def save(folder: Path, name: str, base: mm.Survey, target: mm.Survey) -> None:
    """Write both surveys of a pair, digit for digit."""
    for side, survey in (("base", base), ("target", target)):
        rows = {"positions": survey.positions, "field": survey.field, "pose_sd": np.array(survey.pose_sd)}
        if survey.times is not None:
            rows["times"] = survey.times
        if survey.orientations is not None:
            rows["quaternions"] = survey.orientations.as_quat()
        np.savez(folder / f"{name}.{side}.npz", **rows)


def load(path: Path) -> mm.Survey:
    """Read what `save` wrote."""
    rows = np.load(path)
    turns = Rotation.from_quat(rows["quaternions"]) if "quaternions" in rows else None
    times = rows.get("times")
    return mm.Survey(rows["positions"], rows["field"], times, turns, name=path.stem, pose_sd=float(rows["pose_sd"]))


def make(folder: Path, source: Path) -> None:
    """Draw all pairs; uses rooms of the package that the other verbs leave alone."""
    from magmatch.data.recordings import load_recordings
    from magmatch.geometry import random_transform
    from magmatch.simulation.config import SimulationConfig
    from magmatch.simulation.corruption import corrupt, draw_corruption
    from magmatch_evaluation.survey_pairs import CeaArea, CeaElsewhere, Halves, Interleaved, TwoRecordings

    folder.mkdir(parents=True, exist_ok=True)
    for name, scenario, seed, settings in simulated():
        pair = mm.simulate(scenario, seed, SimulationConfig.model_validate(settings))
        save(folder, name, pair.base, pair.target)
    for seed in range(3):
        pair = mm.simulate("office-hand-held", 40 + seed, SimulationConfig(n_samples=1200))
        rng = np.random.default_rng(seed)
        raw, _ = corrupt(pair.target, draw_corruption(rng), rng)
        save(folder, f"raw-{seed}", pair.base, raw)
    recorded: list[tuple[str, Callable[[int, Path | None], Any], int]] = [
        ("cea-1", CeaArea(1), 2), ("cea-2", CeaArea(2), 2), ("elsewhere", CeaElsewhere(), 4),
        ("aalto-same", TwoRecordings("aalto", "invensense-1", "invensense-2"), 1),
        ("aalto-other", TwoRecordings("aalto", "trivisio-1", "invensense-2"), 1),
        ("jidling", Halves("jidling", "volume"), 1), ("kok-eight", Halves("kok", "eight"), 1),
        ("kok-square", Halves("kok", "square"), 1), ("kaist", Interleaved("kaist", "floor", 20.0), 1),
    ]  # fmt: skip
    for name, pair_of, n in recorded:
        for seed in range(n):
            pair = pair_of(seed, source)
            save(folder, f"{name}-{seed}", pair.base, pair.target)
    walks, rng = load_recordings("cea", source / "cea"), np.random.default_rng(77)
    for floor in (1, 2):
        one, two = walks[f"training-floor{floor}"], walks[f"test-floor{floor}"]
        for length in (10, 20):
            for k in range(2):
                start = int(rng.integers(len(two) - 3000))
                arc = np.cumsum(np.linalg.norm(np.diff(two.positions[start:], axis=0), axis=1))
                stretch = two.subset(start + np.flatnonzero(arc < length))
                target = stretch.transformed(random_transform(rng))
                save(folder, f"walk-{length}-{floor}{k}", around(one, stretch), target)
        other = walks[f"training-floor{3 - floor}"]
        save(folder, f"walk-wrong-floor-{floor}", around(other, stretch), target)


def around(walk: mm.Survey, stretch: mm.Survey) -> mm.Survey:
    """What of a walk lies within 25 m of a stretch, floors apart."""
    return walk.subset(np.linalg.norm(walk.positions[:, :2] - stretch.centroid[:2], axis=1) < 25)


def exact(value: Any) -> Any:
    """Numbers as hexadecimal, everything below as it is."""
    if isinstance(value, dict):
        return {key: exact(v) for key, v in value.items()}
    if isinstance(value, list | tuple):
        return [exact(v) for v in value]
    return value.hex() if isinstance(value, float) else value


def jobs_of(folder: Path) -> Iterator[str]:
    """Names of the pairs, each with how it is registered: ``PAIR/HOW``."""
    names = sorted(path.name.removesuffix(".base.npz") for path in folder.glob("*.base.npz"))
    yield from (f"{name}/default" for name in names)
    yield from (f"{name}/paper" for name in names if name in OF_PAPER)
    yield from (f"{name}/uncalibrated" for name in names if name.startswith(("raw-", "jidling")))
    yield from (f"{name}/upright" for name in names if name.startswith(("corridor-", "z30")))


def answer(folder: Path, job: str) -> dict[str, Any]:
    name, how = job.split("/")
    base, target = (load(folder / f"{name}.{side}.npz") for side in ("base", "target"))
    start = time.perf_counter()
    try:
        document = mm.register(base, target, config_of(how)).to_dict()
    except Exception as error:
        document = dict.fromkeys(KEYS) | {"status": "fault", "reason": repr(error)}
    seconds = time.perf_counter() - start
    print(f"{job}: {document['status']}, {seconds:.1f} s", file=sys.stderr, flush=True)
    return {"name": job, **{key: exact(document[key]) for key in KEYS}, "took": round(seconds, 3)}


def config_of(how: str) -> mm.RegistrationConfig:
    from magmatch.registration.config import PRESETS

    if how == "paper":
        return PRESETS["paper"]
    changes = {"uncalibrated": {"calibrate": False}, "upright": {"prior": {"is_gravity_aligned": True}}}
    return mm.RegistrationConfig.model_validate(changes.get(how, {}))


def compare(before: Path, after: Path) -> int:
    """Print what differs; the number of pairs that do."""
    old, new = ({(r := json.loads(line))["name"]: r for line in p.read_text().splitlines()} for p in (before, after))
    both = [name for name in old if name in new]
    n_different = 0
    for name in both:
        keys = [key for key in KEYS if old[name][key] != new[name][key]]
        if keys:
            n_different += 1
            print(f"{name}: differs in {', '.join(keys)}")
            for key in keys[:3]:
                print(f"    {key}: {str(old[name][key])[:150]} -> {str(new[name][key])[:150]}")
    ratio = np.median([new[name]["took"] / old[name]["took"] for name in both]) if both else np.nan
    print(
        f"{len(both)} pairs compared, {n_different} differ; {len(old) - len(both)} only before, "
        f"{len(new) - len(both)} only after; median ratio of seconds {ratio:.2f}"
    )
    return n_different


def main() -> None:
    asked = arguments(__doc__, (), recordings=None, like="", jobs=1)
    verb, *places = asked.words
    paths = [Path(place) for place in places]
    if verb == "make":
        make(*paths, asked.recordings)
    elif verb == "run":
        folder, answers = paths
        kept(answers, [job for job in jobs_of(folder) if asked.like in job], partial(answer, folder), jobs=asked.jobs)
    elif verb == "compare":
        sys.exit(bool(compare(*paths)))


if __name__ == "__main__":
    main()
