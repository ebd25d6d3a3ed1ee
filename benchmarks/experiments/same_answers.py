# SPDX-License-Identifier: BSD-3-Clause
"""Whether a change of the code changed an answer: a fixed list of pairs, registered before and after.

    python benchmarks/experiments/same_answers.py make PAIRS [--from DIR]     surveys of all pairs, once
    python benchmarks/experiments/same_answers.py run PAIRS ANSWERS.jsonl [--like TEXT] [--jobs N]
    python benchmarks/experiments/same_answers.py compare BEFORE.jsonl AFTER.jsonl [--but among ...]
        [--save same-answers]

Rooms of each overlap, other places, walks, tables, corridors, planes, moved sources, corrupted sensors, recordings,
the published method; some are mapped by each prior, looked for in a folder of maps, corrected by slam and localised.
Numbers are kept as hexadecimal floats, and arrays by a digest of their bytes: equal means equal to the bit. A second
run goes on where the first ended. ``--like TEXT`` takes the pairs whose name holds it. Where all answers are alike,
``--save`` writes both commits down: tables of the first are then of the code of the second, too. ``--but`` names
questions whose answers are meant to differ: the code of a room of that name has changed, and tables of the others are
made anew.
"""

import hashlib
import json
import sys
import time
from collections.abc import Callable, Iterator
from dataclasses import replace
from functools import partial
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np
from scipy.spatial.transform import Rotation

import magmatch as mm
from magmatch.simulation.config import SimulationConfig
from magmatch_evaluation.saved_table import Saver, commits_of, saver
from magmatch_evaluation.script import arguments, kept

ROOM = {"room_size": (3.0, 3.0, 0.6), "n_samples": 1500}
# Statements that do not depend on the clock, the version or the settings' names.
KEYS = (
    "status", "reason", "T_base_target", "covariance", "probability", "evidence", "overlap", "alternatives",
    "degenerate_directions", "sensor", "residual", "fitness", "inliers", "keypoints", "correspondences", "links",
)  # fmt: skip


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
    """Numbers as hexadecimal, arrays as a digest, everything below as it is."""
    if isinstance(value, dict):
        return {key: exact(v) for key, v in value.items()}
    if isinstance(value, list | tuple):
        return [exact(v) for v in value]
    if isinstance(value, np.ndarray):
        return hashlib.sha256(np.ascontiguousarray(value).tobytes()).hexdigest()
    return value.hex() if isinstance(value, float) else value


def jobs_of(folder: Path) -> Iterator[str]:
    """Names of the pairs, each with what is done with it: ``PAIR/HOW``."""
    names = sorted(path.name.removesuffix(".base.npz") for path in folder.glob("*.base.npz"))
    yield from (f"{name}/default" for name in names)
    for how, some in ASKED.items():
        yield from (f"{name}/{how}" for name in names if name.startswith(some))


def answer(folder: Path, job: str) -> dict[str, Any]:
    """What is answered to one job, and the seconds."""
    name, how = job.split("/")
    base, target = (load(folder / f"{name}.{side}.npz") for side in ("base", "target"))
    start = time.perf_counter()
    try:
        found = FOUND.get(how, registered)(base, target, how)
    except Exception as error:
        found = {"fault": repr(error)}
    seconds = time.perf_counter() - start
    print(f"{job}: {found.get('status', '-')}, {seconds:.1f} s", file=sys.stderr, flush=True)
    return {"name": job, "answer": exact(found), "took": round(seconds, 3)}


def registered(base: mm.Survey, target: mm.Survey, how: str) -> dict[str, Any]:
    document = mm.register(base, target, config_of(how)).to_dict()
    return {key: document[key] for key in KEYS}


def config_of(how: str) -> mm.RegistrationConfig:
    from magmatch.registration.config import PRESETS

    if how == "paper":
        return PRESETS["paper"]
    changes = {"uncalibrated": {"calibrate": False}, "upright": {"prior": {"is_gravity_aligned": True}}}
    return mm.RegistrationConfig.model_validate(changes.get(how, {}))


def mapped(base: mm.Survey, target: mm.Survey, how: str) -> dict[str, Any]:  # noqa: ARG001
    """The base's field, its gradient and their uncertainty beside some samples."""
    field_map, points = mm.build_map(base, mm.FieldConfig(prior=how)), base.positions[::11] + 0.05
    values = field_map.evaluate(points, 2)
    covariance = field_map.covariance(points, 1)
    return {"field": values.field, "gradient": values.gradient, "second": values.second, "covariance": covariance}


def among_maps(base: mm.Survey, target: mm.Survey, how: str) -> dict[str, Any]:  # noqa: ARG001
    """The pair, with another map beside the base's."""
    other = mm.simulate("office-random", 950, SimulationConfig(n_samples=1200)).base
    with TemporaryDirectory() as folder:
        for k, survey in enumerate((other, base)):
            mm.build_map(survey).save(Path(folder) / f"{k}.map")
        document = mm.register(folder, target).to_dict()
    return {key: document[key] for key in (*KEYS, "base")}


def corrected(base: mm.Survey, target: mm.Survey, how: str) -> dict[str, Any]:  # noqa: ARG001
    """Both walks as two logs."""
    session = mm.slam([replace(base, name="base"), replace(target, name="target")])
    result = session.result().to_dict()
    paths = {log.name: log.positions for log in session.trajectories}
    return {"logs": result["logs"], "closures": result["closures"], "status": result["status"], "paths": paths}


def followed(base: mm.Survey, target: mm.Survey, how: str) -> dict[str, Any]:
    """The target's walk in the base's map, with hindsight or live."""
    if target.times is None:
        target = replace(target, times=0.02 * np.arange(len(target)))
    track = mm.localize(mm.build_map(base), target, live=how == "live")
    return {"stated": track.is_stated, "poses": track.poses.as_matrix(), "sd": track.sd}


# What is done with some pairs besides registering them by default, by the beginnings of their names.
ASKED = {
    "paper": ("room-1-0", "room-0.5-1", "nowhere-0", "table-0", "z30-0", "x30-1"),
    "uncalibrated": ("raw-", "jidling"),
    "upright": ("corridor-", "z30"),
    "harmonic": ("room-0.5-0", "table-1", "jidling", "cea-1-0"),
    "curl_free": ("room-0.5-0", "jidling"),
    "divergence_free": ("room-0.5-0", "jidling"),
    "spline": ("room-0.5-0", "table-1", "jidling", "kok-eight", "walk-20-10"),
    "auto": ("room-0.3-0", "cea-1-0", "corridor-0"),
    "among": ("room-0.75-1", "room-0.3-2", "walk-20-10", "nowhere-1"),
    "slam": ("corridor-0", "drift-0.05", "walk-20-20", "hand-held-0"),
    "localize": ("corridor-0", "drift-0.1", "walk-20-10", "walk-20-20", "nowhere-2"),
    "live": ("corridor-1", "walk-20-20"),
}
PRIORS = ("harmonic", "curl_free", "divergence_free", "spline", "auto")
FOUND = {
    "among": among_maps, "slam": corrected, "localize": followed, "live": followed, **dict.fromkeys(PRIORS, mapped),
}  # fmt: skip


def compare(before: Path, after: Path, but: list[str], save: Saver | None) -> int:
    """Print what differs; the number of answers that do and are not meant to."""
    old, new = ({(r := json.loads(line))["name"]: r for line in p.read_text().splitlines()} for p in (before, after))
    both = [name for name in old if name in new]
    n_different, n_meant = 0, 0
    for name in both:
        was, now = old[name]["answer"], new[name]["answer"]
        keys = [key for key in was | now if was.get(key) != now.get(key)]
        if keys:
            is_meant = name.partition("/")[2] in but
            n_meant += is_meant
            n_different += not is_meant
            print(f"{name}: differs in {', '.join(keys)}{', as it is meant to' if is_meant else ''}")
            for key in keys[:3]:
                print(f"    {key}: {str(was.get(key))[:150]} -> {str(now.get(key))[:150]}")
    ratio = np.median([new[name]["took"] / old[name]["took"] for name in both]) if both else np.nan
    print(
        f"{len(both)} answers compared, {n_different} differ, {n_meant} as meant; "
        f"{len(old) - len(both)} only before, {len(new) - len(both)} only after; median ratio of seconds {ratio:.2f}"
    )
    if save is not None and not n_different and len(both) == len(old) == len(new):
        (first,), (last,) = commits_of(old.values()), commits_of(new.values())
        said = str(len(both) - n_meant) + f" ({', '.join(but)}: meant to differ)" * bool(but)
        save(save.old.columns, [*save.old.rows, [first, last, said]], commits=[last])
    return n_different


def main() -> None:
    asked = arguments(__doc__, (), recordings=None, like="", but=[], jobs=1, save=saver)
    verb, *places = asked.words
    paths = [Path(place) for place in places]
    if verb == "make":
        make(*paths, asked.recordings)
    elif verb == "run":
        folder, answers = paths
        kept(answers, [job for job in jobs_of(folder) if asked.like in job], partial(answer, folder), jobs=asked.jobs)
    elif verb == "compare":
        sys.exit(bool(compare(*paths, asked.but, asked.save)))


if __name__ == "__main__":
    main()
