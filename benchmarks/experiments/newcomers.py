# SPDX-License-Identifier: BSD-3-Clause
"""What newcomers bring: walks with phones, registered with each other and with maps of the others.

    python benchmarks/experiments/newcomers.py --data DIR --out DIR [--quick] [--jobs N] [--minutes M] [--save NAME]

DIR holds ``dodolilo/infcenter`` (9 walks of one phone through a server room), ``ipin2023/pdr`` (5 routes of a museum,
two walks with each of two phones) and ``make_surveys.py``, which puts the walks at their true positions. Pairs share
20 m of path or more, or are of different places (less than 1 m shared); each target is turned about the vertical and
shifted at random. Every pair is registered as it is (*any pose*) and with ``--gravity-aligned --planar`` (*planar*).
Walks *with their own odometry* drift; their true pose is the best fit of the odometry to the true positions.

Right: within 0.5 m (museum: 1 m) and 3 degrees or two stated standard deviations; wrong: accepted more than 1.5 m or
8 degrees off, or between different places. *Best candidate right*: the first pose, accepted or not, within 0.5 m
(1 m) and 8 degrees: headings are known so well. With odometry right is within three stated standard deviations,
or refused with a reason that names drift: found in the halves of the walk, or as a question.
Maps of bases are made before, once, and are not in the seconds. Rows stay in ``--out``, a second run goes on
where the first ended. Planar rows come first; a run that ends early has the same share of every kind of pair.
``--quick`` takes every eighth pair.
"""

import logging
from collections.abc import Iterable, Iterator
from functools import cache, partial
from itertools import combinations, product
from pathlib import Path
from typing import Any
from zlib import crc32

import numpy as np
from localize_walks import real_walk, survey_at_truth
from scipy.spatial import cKDTree
from scipy.spatial.transform import RigidTransform, Rotation

import magmatch as mm
from magmatch.field.config import SPLINE
from magmatch.registration.config import RegistrationConfig
from magmatch.registration.weigh.bend import DRIFTS
from magmatch_evaluation.saved_table import saver, show
from magmatch_evaluation.script import arguments, kept, pose_error, timed
from magmatch_evaluation.trial import nees_of

COLUMNS = (
    "pairs", "known of the pose", "n", "right", "wrong", "refused", "best candidate right",
    "of these accepted", "NEES", "median error of the right", "stated sd", "s a pair",
)  # fmt: skip
SHARED, NEAR = 20.0, 1.0  # m of path, and from what distance it counts as shared
TOLERANCE = {"inf": 0.5, "ipin": 1.0}  # m
RIGHT_DEG, HEADINGS_DEG = 3.0, 8.0
WRONG_M, WRONG_DEG = 1.5, 8.0
MODES = ("any pose", "planar")
KINDS = {
    "walk": "walk to walk", "map": "walk to map of the others", "other": "different places",
    "odo-walk": "odometry to walk at true positions", "odo-map": "odometry to map of the others",
    "odo-odo": "odometry to odometry",
}  # fmt: skip
WALKS = [f"inf_{k}" for k in range(1, 10)] + [f"ipin_{r}_{k}" for r, k in product(range(1, 6), range(1, 5))]


@cache
def survey(data: Path, out: Path, walk: str) -> mm.Survey:
    """A walk at its true positions; with ``odo-`` before its name, with its own odometry."""
    place, name = walk.removeprefix("odo-").split("_", 1)
    walk_there = {"inf": "walk", "ipin": "route"}[place] + name
    return real_walk(walk_there, data)[0] if walk.startswith("odo-") else survey_at_truth(walk_there, data, out)


def others(walk: str) -> list[str]:
    """The other walks of its room or route."""
    site = site_of(walk)
    return [w for w in WALKS if site_of(w) == site and w != walk]


def site_of(walk: str) -> str:
    return walk.split("_", maxsplit=1)[0] if walk.startswith("inf") else walk.rsplit("_", 1)[0]


@cache
def map_of(data: Path, out: Path, *walks: str) -> mm.FieldMap:
    """Map of walks, made once."""
    path = out / f"{'+'.join(walks)}.map"
    if not path.exists():
        mm.build_map([survey(data, out, walk) for walk in walks], SPLINE).save(path)
    return mm.FieldMap.load(path)


def shared_path(base: mm.Survey, target: mm.Survey) -> float:
    """How much of the target's path (m) the base passes too."""
    near = cKDTree(base.positions[:, :2]).query(target.positions[:, :2])[0] < NEAR
    steps = np.linalg.norm(np.diff(target.positions[:, :2], axis=0), axis=1)
    return float(steps[near[1:]].sum())


def to_truth(data: Path, out: Path, walk: str) -> RigidTransform:
    """Best fit of a walk's odometry to its true positions, in the plane."""
    odometry, true = survey(data, out, f"odo-{walk}"), survey(data, out, walk)
    rows = np.searchsorted(odometry.times, true.times - 1e-6)
    p, q = odometry.positions[rows, :2], true.positions[:, :2]
    turn = np.angle(((p - p.mean(0)) @ [1, -1j]) @ ((q - q.mean(0)) @ [1, 1j]))
    R = Rotation.from_euler("z", turn)
    return RigidTransform.from_components(np.array([*q.mean(0), 0]) - R.apply([*p.mean(0), 0]), R)


def pairs(data: Path, out: Path) -> Iterator[str]:
    """Names of all pairs: ``KIND BASE TARGET``."""
    at_truth = partial(survey, data, out)
    for base, target in combinations(WALKS, 2):
        if site_of(base) == site_of(target):
            if min(shared_path(*map(at_truth, ends)) for ends in ((base, target), (target, base))) >= SHARED:
                yield f"walk {base} {target}"
        # Of two routes one walk each, with different phones.
        elif base.startswith("ipin") and base.endswith("_1") and target.endswith("_3"):
            shared = shared_path(at_truth(base), at_truth(target))
            if shared >= SHARED or shared < NEAR:
                yield f"{'walk' if shared >= SHARED else 'other'} {base} {target}"
        elif base.startswith("inf") and target.endswith(f"_{int(base[-1]) % 4 + 1}"):
            yield f"other {base} {target}"
    for walk in WALKS:
        yield f"map {walk} {walk}"
        yield f"odo-map {walk} {walk}"
        yield f"odo-walk {others(walk)[0]} {walk}"
        yield f"odo-odo {others(walk)[-1]} {walk}"


def evenly(names: Iterable[str]) -> list[str]:
    """Pairs in an order of which every beginning has the same share of every kind and place."""
    groups: dict[tuple[str, str], list[str]] = {}
    for name in sorted(names, key=lambda name: crc32(name.encode())):
        kind, _, walk = name.split(" ")
        groups.setdefault((kind, walk.split("_")[0]), []).append(name)
    share = {name: (k + 0.5) / len(group) for group in groups.values() for k, name in enumerate(group)}
    return sorted(share, key=lambda name: share[name])


def one(data: Path, out: Path, name: str) -> dict[str, Any]:
    """Register one pair: name is ``KIND BASE TARGET MODE``."""
    kind, base_walk, walk, mode = name.split(" ", 3)
    moved = kind.startswith("odo")
    target = survey(data, out, f"odo-{walk}" if moved else walk)
    T_base_true = RigidTransform.identity()
    if kind.endswith("map"):
        base = map_of(data, out, *others(walk))
    elif kind == "odo-odo":
        base, T_base_true = map_of(data, out, f"odo-{base_walk}"), to_truth(data, out, base_walk).inv()
    else:
        base = map_of(data, out, base_walk)
    rng = np.random.default_rng(crc32(name.rsplit(" ", len(mode.split()))[0].encode()))
    turn = Rotation.from_euler("z", rng.uniform(-np.pi, np.pi))
    T_new_target = RigidTransform.from_components([*rng.uniform(-50, 50, 2), 0.0], turn)
    T_true = T_base_true * (to_truth(data, out, walk) if moved else RigidTransform.identity()) * T_new_target.inv()
    target = target.transformed(T_new_target)
    is_planar = mode == "planar"
    prior = {"is_gravity_aligned": is_planar, "is_planar": is_planar}
    result, seconds, _ = timed(mm.register, base, target, RegistrationConfig.model_validate({"prior": prior}))
    distance, angle = pose_error(result, T_true, target.centroid)
    sd = result.standard_deviations or (np.nan, np.nan)
    return {
        "name": name, "status": str(result.status), "reason": result.reason, "probability": result.probability,
        "error": [distance, float(np.degrees(angle))], "sd": [sd[1], float(np.degrees(sd[0]))], "seconds": seconds,
        "nees": nees_of(result, T_true),
    }  # fmt: skip


class Row:
    """What a row says of its pair."""

    def __init__(self, row: dict[str, Any]) -> None:
        self.kind, _, walk, self.mode = row["name"].split(" ", 3)
        self.walk, self.seconds, self.reason = walk, row["seconds"], row["reason"]
        self.error, self.sd = np.array(row["error"], dtype=float), np.array(row["sd"], dtype=float)
        self.nees = row["nees"]
        self.is_accepted = row["status"] == "accepted"
        m, deg = self.error
        is_near, is_there = m <= TOLERANCE[walk.split("_")[0]], self.kind != "other"
        self.best_is_right = bool(is_there and is_near and deg <= HEADINGS_DEG)
        if self.kind.startswith("odo"):
            is_within = (self.error <= 3 * self.sd).all()
            is_far = not is_within
        else:
            is_within = is_near and deg <= max(RIGHT_DEG, np.nan_to_num(2 * self.sd[1]))
            is_far = m > WRONG_M or deg > WRONG_DEG
        self.is_right = bool(self.is_accepted and is_there and is_within)
        self.is_wrong = bool(self.is_accepted and (is_far or not is_there))
        self.names_drift = not self.is_accepted and "drift" in self.reason
        self.finds_drift = not self.is_accepted and DRIFTS in self.reason


def table(rows: list[Row]) -> list[list[str]]:
    lines = []
    for kind, place, mode in product(KINDS, TOLERANCE, MODES):
        these = [r for r in rows if (r.kind, r.mode) == (kind, mode) and r.walk.startswith(place)]
        if not these:
            continue
        n, right, good = len(these), [r for r in these if r.is_right], [r for r in these if r.best_is_right]
        stated = [r.nees for r in these if r.is_accepted]
        error, sd = (
            "{:.2f} m, {:.1f} deg".format(*np.median(values, axis=0)) if right else ""
            for values in ([r.error for r in right], [r.sd for r in right])
        )
        said = f"{len(right)} ({len(right) / n:.0%})"
        if kind.startswith("odo"):
            said += f", or refused naming drift: {sum(r.names_drift for r in these)}"
            said += f", of these found: {sum(r.finds_drift for r in these)}"
        lines.append([
            f"{KINDS[kind]}, {'server room' if place == 'inf' else 'museum'}", mode, str(n), said,
            str(sum(r.is_wrong for r in these)), str(sum(not r.is_accepted for r in these)), str(len(good)),
            str(sum(r.is_accepted for r in good)),
            f"{np.mean(stated):.2f}" if stated else "", error, sd,
            f"{np.median([r.seconds for r in these]):.1f}",
        ])  # fmt: skip
    return lines


def main() -> None:
    asked = arguments(
        __doc__, data=Path, out=Path, quick=False, modes=list(MODES), jobs=1, minutes=np.inf, save=saver
    )
    logging.getLogger("magmatch").setLevel(logging.ERROR)
    asked.out.mkdir(parents=True, exist_ok=True)
    wanted = evenly(pairs(asked.data, asked.out))[:: 8 if asked.quick else 1]
    names = [f"{pair} {mode}" for mode in reversed(asked.modes) for pair in wanted]
    make = partial(one, asked.data, asked.out)
    found = kept(asked.out / "rows.jsonl", names, make, jobs=asked.jobs, minutes=asked.minutes)
    show(COLUMNS, table([Row(row) for row in found.values()]), asked.save, found.values())
    for name, row in sorted(found.items()):
        told = Row(row)
        if told.is_wrong or (told.best_is_right and not told.is_accepted):
            (m, deg), (sd_m, sd_deg) = told.error, told.sd
            print(
                f"{name}: {m:.2f} m, {deg:.1f} deg, sd {sd_m:.2f} m, {sd_deg:.1f} deg; {row['status']}: {told.reason}"
            )


if __name__ == "__main__":
    main()
