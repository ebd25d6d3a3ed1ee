"""Pairs of known truth: fit how evidence turns into probability, or report how good stated probabilities are.

    python benchmarks/experiments/fit_decision.py --out DIR [--first 510000] [--rooms 20] [--kinds 8] [--walks 40]
        [--areas 20] [--pairs 1000] [--overlaps 100 75 50 30 15] [--moved 10 20 30 40] [--lengths 20 10 5] [--skip 0]
        [--jobs 2] [--minutes M] [--from RECORDINGS] [--fit] [--save NAME]

Registered are rooms of five overlaps (in %), rooms of which a share of the sources moved (in %), rooms and robots of
18 further kinds, rooms that repeat, areas of a building, stretches of 20, 10 and 5 m of its second walk in the map of
the first and in the map of the other floor, and maps of different places. Little overlap and short stretches make
pairs that are doubtful. ``--fit`` prints numbers for ``decide/fitted.json`` that are fitted to all of them; else the
tables say how good the packaged ones are: report on seeds, or walks (``--skip``), that no fit has seen. Pairs of one
place and of different places weigh alike, as do maps and walks: the prior odds are one. Maps and rows stay in DIR; a
second run goes on where the first ended.
"""

import os
import zlib
from collections.abc import Iterator
from functools import lru_cache, partial
from itertools import pairwise, product
from pathlib import Path
from typing import Any

import numpy as np
from many_rooms import load, map_of, site_of
from scipy.optimize import minimize
from scipy.spatial.transform import RigidTransform
from scipy.special import logsumexp
from short_walks import stretches

import magmatch as mm
from magmatch.data.recordings import load_recordings
from magmatch.data.survey import Survey
from magmatch.estimation.posterior import Fitted, answers_of, fitted, log_odds, posterior_of
from magmatch.geometry import random_transform, transform_error
from magmatch.registration.clock import Clock
from magmatch.registration.config import PRESETS
from magmatch.registration.index.map_index import MapIndex, prepare_index
from magmatch.registration.steps import refine_and_weigh, settle_and_decide, strategies
from magmatch.simulation.config import SimulationConfig
from magmatch.simulation.scene import SimulatedPair
from magmatch.threads import one_blas_thread
from magmatch_evaluation.saved_table import saver, show
from magmatch_evaluation.script import arguments, kept
from magmatch_evaluation.statistics import wilson_interval
from magmatch_evaluation.survey_pairs import area

ROOM = {"room_size": (3.0, 3.0, 0.6)}
KINDS: dict[str, tuple[str, dict[str, Any]]] = {
    "full": ("office-random", {}),
    "overlap-75": ("office-random", {"overlap": 0.75}),
    "overlap-50": ("office-random", {"overlap": 0.5}),
    "overlap-30": ("office-random", {"overlap": 0.3}),
    "overlap-15": ("office-random", {"overlap": 0.15}),
    "noise-5uT": ("office-random", {"noise_sd": 5e-6}),
    "samples-400": ("office-random", {"n_samples": 400}),
    "pose-3cm": ("office-random", {"pose_noise_sd": 0.03}),
    "pose-10cm": ("office-random", {"pose_noise_sd": 0.1}),
    "sensor": ("office-random", {"bias": (1.2e-6, -1.2e-6, 1e-6), "scale": 0.03}),
    "moved": ("office-random", {"moved_sources": 0.15}),
    "inside": ("office-inside", {}),
    "planar": ("planar", {}),
    "hand-held": ("office-hand-held", {}),
    "robot": ("office-robot", {}),
    "drift": ("corridor", {"pose_drift": 0.02}),
    "uniform": ("uniform", {}),
    "repeated": ("repeated", {"room_size": (3.0, 3.0, 1.0)}),
    "nowhere": ("nowhere", {"room_size": (3.0, 3.0, 1.0)}),
    "table": ("table", {"n_samples": 1200}),
}
# No pose is right, or none of three is more right than the others.
NOWHERE, REPEATED = ("uniform", "nowhere"), "repeated"
CONFIG = PRESETS["default"]
BINS = (0, 0.01, 0.05, 0.2, 0.5, 0.8, 0.95, 0.99, 1.0001)
Row = dict[str, Any]


def room(kind: str, seed: int) -> SimulatedPair:
    """A simulated pair; overlaps and moved sources by their percentage."""
    name = kind.rstrip("0123456789")
    if name in ("ov", "moved") and name != kind:
        scenario = "office-random"
        changes = {"overlap" if name == "ov" else "moved_sources": int(kind[len(name) :]) / 100}
    else:
        scenario, changes = KINDS[kind]
    return mm.simulate(scenario, seed, SimulationConfig.model_validate(ROOM | changes))


@lru_cache(maxsize=1)
def building(source: Path | None) -> dict[str, Survey]:
    return load_recordings("cea", source)


@lru_cache(maxsize=3)
def walked(walk: str, folder: Path, source: Path | None) -> MapIndex:
    """A walk through the building as a base for walks."""
    return prepare_index(map_of(building(source)[walk], folder / f"cea-{walk}.map"))


def weighed(index: MapIndex, target: Survey | mm.FieldMap, samples: Survey, search: str) -> Iterator[Row]:
    """What each strategy that is tried says of a pair: its poses, and the answer."""
    config, clock = CONFIG.model_copy(update={"search": search}), Clock()
    for strategy in strategies(index.length, target, samples, config, 0, clock):
        pair = strategy.pair(index)
        found = refine_and_weigh(strategy, pair, strategy.search(pair))
        answer = settle_and_decide(found, config.decision, clock)
        tolerance = config.decision.tolerance(found.pair.length)
        poses = []
        for p in posterior_of(answers_of(found.ranked, tolerance)).poses:
            T = found.pair.estimate(p).T_base_target.as_matrix().tolist()
            poses.append({"kind": p.kind, "log_evidence": p.log_evidence, "misfit": p.misfit, "T": T})
        yield {"status": answer.status.value, "reason": answer.reason, "tolerance": tolerance, "poses": poses}
        if answer.is_accepted:
            return


def make(name: str, *, folder: Path, source: Path | None) -> Row:
    what, *words = name.split(" ")
    search, T_true = "auto", None
    if what == "room":
        kind, seed = words
        pair, maps = room(kind, int(seed)), folder / "maps"
        base, target = (map_of(getattr(pair, s), maps / f"{kind}-{seed}.{s[0]}.map") for s in ("base", "target"))
        samples, T_true = target.survey, None if kind in NOWHERE else pair.T_base_target
    elif what == "area":
        base, target, samples, T_true = cut_area(int(words[0]), int(words[1]), folder / "maps", source)
    elif what == "walk":
        _, floor, length, _ = words
        rng = np.random.default_rng(zlib.crc32("-".join(words).encode()))
        stretch = next(stretches(building(source)[f"test-floor{floor}"], float(length), 1, rng))
        T = random_transform(rng)
        target = samples = stretch.transformed(T.inv())
        search, T_true = "pairs", T if words[0] == "training" else None
    else:
        base, target = (load(folder / "maps" / f"{word}.map") for word in words)
        samples = target.survey
    with one_blas_thread():
        index = walked(words[0], folder / "maps", source) if what == "walk" else prepare_index(base)
        tried = list(weighed(index, target, samples, search))
    for one in tried:
        for pose in one["poses"]:
            T = RigidTransform.from_matrix(pose.pop("T"))
            pose["error"] = (np.inf, np.inf) if T_true is None else transform_error(T, T_true, samples.centroid)
            pose["is_right"] = all(e <= t for e, t in zip(pose["error"], one["tolerance"], strict=True))
    return {"name": name, "tried": tried}


def cut_area(floor: int, k: int, maps: Path, source: Path | None) -> tuple[mm.FieldMap, mm.FieldMap, Survey, Any]:
    """A square of the building from both walks."""
    rng = np.random.default_rng([floor, k, 5])
    one, two = (building(source)[f"{walk}-floor{floor}"] for walk in ("training", "test"))
    while True:
        center, side = two.positions[rng.integers(len(two)), :2], rng.uniform(8, 18)
        cut = [area(s, center, side) for s in (one, two)]
        if min(map(len, cut)) >= 300:
            break
    T = random_transform(rng)
    target = cut[1].transformed(T.inv())
    base, mapped = (map_of(s, maps / f"cea-{floor}-{k}.{side}.map") for s, side in ((cut[0], "b"), (target, "t")))
    return base, mapped, target, T


def names(asked: Any) -> Iterator[str]:
    """Pairs of one place, and walks on the wrong floor."""
    for k in range(asked.rooms):
        yield from (f"room ov{overlap} {asked.first + 10 * k + j}" for j, overlap in enumerate(asked.overlaps))
        yield from (f"room moved{share} {asked.first + 10000 + 10 * k + j}" for j, share in enumerate(asked.moved))
    for k in range(asked.kinds):
        yield from (f"room {kind} {asked.first + 20000 + k}" for kind in KINDS)
    for k, floor, length in product(range(asked.skip, asked.skip + asked.walks), (1, 2), asked.lengths):
        yield from (f"walk {base} {floor} {length} {k}" for base in ("training", f"training-floor{3 - floor}"))
    for k in range(asked.skip, asked.skip + asked.areas):
        yield from (f"area {floor} {k}" for floor in (1, 2))


def crossed(folder: Path, n: int, seed: int, lines: str = "") -> list[str]:
    """Maps of different places: rooms of different seeds, floors; only those whose names begin so, if it is said."""
    rng, found = np.random.default_rng(seed), []
    maps = sorted(p.name.removesuffix(".map") for p in (folder / "maps").glob(f"{lines}*.map"))
    maps = [name for name in maps if "-training" not in name]
    while len(found) < n:
        few = rng.choice(maps, min(30, len(maps)), replace=False)
        pairs = [rng.choice(few, 2, replace=False) for _ in range(100)]
        found += [f"cross {a} {b}" for a, b in pairs if site_of(a) != site_of(b)]
    return found[:n]


def is_of_one_place(name: str) -> bool:
    """Whether some pose is right."""
    what, kind, *_ = name.split(" ")
    return what == "area" or (what == "room" and kind not in NOWHERE) or (what == "walk" and kind == "training")


def group(name: str) -> str:
    """What a pair is counted with."""
    what, kind, *words = name.split(" ")
    if what == "walk":
        return f"walk of {words[1]} m, " + ("own floor" if kind == "training" else "other floor")
    return {"area": "area of a building", "cross": "different places"}.get(what, kind)


def cases(rows: list[Row]) -> list[tuple[str, Row]]:
    """One case for each strategy that was tried and found another best pose than those before."""
    found: dict[tuple[str, float], Row] = {}
    for row in rows:
        for one in row["tried"]:
            if one["poses"]:
                found.setdefault((row["name"], round(one["poses"][0]["log_evidence"], 1)), one)
    return [(name, one) for (name, _), one in found.items()]


def shares(one: Row, numbers: Fitted, prior_odds: float = 1.0) -> np.ndarray:
    """Probability of each pose, and of unrelated surveys last."""
    odds = [log_odds(p["log_evidence"], p["misfit"], p["kind"], numbers) for p in one["poses"]]
    terms = np.array([*odds, -np.log(prior_odds)])
    return np.exp(terms - logsumexp(terms))


def truth(name: str, one: Row) -> np.ndarray:
    """How probable each outcome is, seen from outside: one is, but of rooms that repeat three are alike."""
    n = len(one["poses"])
    if name.startswith(f"room {REPEATED}"):
        return np.array([1.0] * min(n, 3) + [0.0] * (n + 1 - min(n, 3))) / min(n, 3)
    right = [k for k, p in enumerate(one["poses"]) if p["is_right"]]
    return np.eye(n + 1)[right[0] if right else n]


def weights_of(found: list[tuple[str, Row]]) -> np.ndarray:
    """One place and different places alike, maps and walks alike."""
    kinds = np.array([2 * is_of_one_place(name) + (one["poses"][0]["kind"] == "map") for name, one in found])
    return np.asarray(1.0 / np.bincount(kinds, minlength=4)[kinds])


def fit(found: list[tuple[str, Row]]) -> Fitted:
    """Maximum likelihood; a hundredth of the truths is taken for wrong, so that no few pairs decide."""
    weights, truths = weights_of(found), [truth(name, one) for name, one in found]

    def numbers(v: np.ndarray) -> Fitted:
        offset = {"map": float(v[2]), "walk": float(v[3])}
        return Fitted(scale=np.exp(v[0]), saturation=np.exp(v[1]), offset=offset)

    def loss(v: np.ndarray) -> float:
        law = numbers(v)
        stated = (0.98 * shares(one, law) + 0.01 for _, one in found)
        return -sum(w * float(t @ np.log(p)) for w, t, p in zip(weights, truths, stated, strict=True))

    start = np.array([np.log(8.0), np.log(20.0), 2.0, -1.0])
    return numbers(minimize(loss, start, method="Nelder-Mead", options={"maxiter": 2000, "fatol": 1e-6}).x)


def report(found: list[tuple[str, Row]], law: Fitted) -> tuple[list[list[str]], list[list[str]]]:
    """Tables: what is probable enough of each group, and how often poses of each stated probability are right."""
    right = np.array([one["poses"][0]["is_right"] for _, one in found])
    probable = np.array([shares(one, law)[0] >= CONFIG.decision.min_probability for _, one in found])
    groups, by_group = np.array([group(name) for name, _ in found]), []
    for g in dict.fromkeys(groups):
        rows = groups == g
        both = (right & probable & rows).sum()
        by_group.append([g, *map(str, (rows.sum(), (right & rows).sum(), both, (probable & ~right & rows).sum()))])
    weights, same = weights_of(found), np.array([is_of_one_place(name) for name, _ in found])
    by_bin = []
    for odds in (1.0, 1 / 9, 1 / 99):
        p = np.array([shares(one, law, odds)[0] for _, one in found])
        w = weights * np.where(same, 1.0, 1 / odds)
        brier = np.average((p - right) ** 2, weights=w)
        log_loss = -np.average(np.log(np.clip(np.where(right, p, 1 - p), 1e-6, 1)), weights=w)
        for low, high in pairwise(BINS):
            rows = (p >= low) & (p < high)
            if rows.any():
                n, share = int(rows.sum()), np.average(right[rows], weights=w[rows])
                n_effective = w[rows].sum() ** 2 / (w[rows] ** 2).sum()
                interval = wilson_interval(share * n_effective, n_effective)
                by_bin.append([
                    f"1:{1 / odds:.0f}", f"{low:g} to {min(high, 1):g}", str(n),
                    f"{np.average(p[rows], weights=w[rows]):.4f}",
                    f"{share:.4f}", f"{interval[0]:.3f} to {interval[1]:.3f}", f"{brier:.4f}", f"{log_loss:.4f}",
                ])  # fmt: skip
    return by_group, by_bin


GROUP_COLUMNS = ("pairs", "n", "best pose right", "right and probable", "wrong and probable")
BIN_COLUMNS = ("prior odds", "stated", "n", "mean stated", "right", "95 % bounds", "Brier score", "log loss")


def main() -> None:
    asked = arguments(
        __doc__, out=Path, first=510000, rooms=20, kinds=8, walks=40, areas=20, pairs=1000,
        overlaps=[100, 75, 50, 30, 15], moved=[10, 20, 30, 40], lengths=[20, 10, 5], skip=0, jobs=os.cpu_count(),
        minutes=np.inf, recordings=None, fit=False, save=saver, save_reliability=saver,
    )  # fmt: skip
    (asked.out / "maps").mkdir(parents=True, exist_ok=True)
    source = asked.recordings and asked.recordings / "cea"
    work, how = partial(make, folder=asked.out, source=source), {"jobs": asked.jobs, "minutes": asked.minutes}
    wanted = list(names(asked))
    np.random.default_rng(0).shuffle(wanted)
    found = kept(asked.out / "pairs.jsonl", wanted, work, **how)
    wanted = crossed(asked.out, asked.pairs, asked.first)
    # Areas of one building, whose floors are alike and whose walks are lines.
    wanted += crossed(asked.out, asked.pairs // 10, asked.first, "cea-") if asked.areas else []
    found |= kept(asked.out / "pairs.jsonl", wanted, work, **how)
    everything = cases(list(found.values()))
    print(f"{len(found)} pairs")
    if asked.fit:
        print(fit(everything).model_dump_json(indent=1))
        return
    by_group, by_bin = report(everything, fitted())
    show(GROUP_COLUMNS, by_group, asked.save, found.values())
    show(BIN_COLUMNS, by_bin, asked.save_reliability, found.values())


if __name__ == "__main__":
    main()
