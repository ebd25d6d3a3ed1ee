"""Match surveys of one place and of different places; fit or check the probability that results state.

    python benchmarks/experiments/calibrate_probability.py --out DIR [--first 2000] [--seeds 3] [--cross 400]
        [--from RECORDINGS] [--fit]

Rooms of many kinds (overlaps, noises, sample counts, furniture, moved furniture, planes, hand-held and robot surveys)
are simulated, areas of a building and robots' runs are cut from public recordings, and all are mapped. Each pair of
one place is registered, and so are ``--cross`` pairs of surveys of different places: every map meets many others, so
wrong answers are cheap to look for. Maps and rows stay in DIR; a second run goes on where the first ended. Prints a
table by kind of pair, how many wrong answers were accepted and how often poses of each stated probability were right;
with ``--fit``, the weights for `magmatch.registration.decide.probability` (then report on other seeds).
"""

from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from scipy.optimize import minimize

import magmatch as mm
from magmatch.data.recordings import load_recordings
from magmatch.data.survey import Survey
from magmatch.geometry import random_transform
from magmatch.registration.config import PRESETS
from magmatch.registration.decide.probability import features
from magmatch.simulation.config import SimulationConfig
from magmatch_evaluation.script import arguments, kept, pose_error
from magmatch_evaluation.survey_pairs import area
from magmatch_evaluation.trial import nees_of

ROOM = SimulationConfig(room_size=(3.0, 3.0, 0.6))
CONDITIONS: dict[str, tuple[str, dict[str, object]]] = {
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
}
# A pose is right within this of the truth.
MAX_DEG = 3.0
# Decoys are tried from here on, so that the model sees what they say of doubtful poses.
SETTINGS = PRESETS["default"].model_copy(
    update={"decision": PRESETS["default"].decision.model_copy(update={"min_log_evidence": 5.0})}
)


@dataclass(frozen=True)
class Place:
    """Two surveys of one place: what they are called, where they are, and how far an answer may be off."""

    name: str
    site: str  # surveys of one site may overlap
    pair: tuple[Survey, Survey]
    T_base_target: object
    max_m: float


def simulated(first: int, n: int) -> Iterator[Place]:
    """Rooms of every kind; rooms of one seed share their structures."""
    for seed in range(first, first + n):
        for name, (scenario, changes) in CONDITIONS.items():
            pair = mm.simulate(scenario, seed, ROOM.model_copy(update=changes))
            max_m = 0.25 if name == "drift" else 0.06
            yield Place(f"{name}-{seed}", f"room {seed}", (pair.base, pair.target), pair.T_base_target, max_m)


def recorded(source: Path | None, n_areas: int, seed: int) -> Iterator[Place]:
    """Areas of two walks through a building, a robot's runs, halves of a hand-held survey."""
    rng = np.random.default_rng(seed)
    cea, aalto, jidling = (load_recordings(name, source) for name in ("cea", "aalto", "jidling"))
    pairs = []
    for floor in (1, 2):
        one, two = cea[f"training-floor{floor}"], cea[f"test-floor{floor}"]
        while sum(site == f"cea {floor}" for _, site, *_ in pairs) < n_areas:
            center, side = two.positions[rng.integers(len(two)), :2], rng.uniform(8, 18)
            cut = [area(s, center, side) for s in (one, two)]
            if min(len(c) for c in cut) >= 300:
                pairs.append((f"cea-{floor}-{len(pairs)}-{seed}", f"cea {floor}", *cut, 0.25))
    for one, two in (
        ("invensense-1", "invensense-2"),
        ("invensense-1", "trivisio-2"),
        ("invensense-2", "invensense-4"),
    ):
        pairs.append((f"aalto-{one}-{two}", "motion capture", aalto[one], aalto[two], 0.1))
    half = np.arange(len(jidling["volume"])) < len(jidling["volume"]) // 2
    pairs.append(("jidling", "motion capture", *(jidling["volume"].subset(h) for h in (half, ~half)), 0.06))
    for name, site, base, target, max_m in pairs:
        T = random_transform(rng)
        yield Place(name, site, (base, target.transformed(T.inv())), T, max_m)


def mapped(place: Place, folder: Path) -> tuple[mm.FieldMap, mm.FieldMap]:
    """Maps of both surveys, made once."""
    found = []
    for side, survey in zip(("base", "target"), place.pair, strict=True):
        path = folder / f"{place.name}.{side}.map"
        if not path.exists():
            mm.build_map(survey).save(path)
        found.append(mm.FieldMap.load(path))
    return found[0], found[1]


def row_of(
    name: str, result: mm.RegistrationResult, is_right: bool, error: tuple[float, float, float] = (np.inf,) * 3
) -> dict[str, object]:
    """What is kept of one registration: among others the error in m and rad, and squared over its covariance."""
    return {
        "name": name,
        "is_right": bool(is_right),
        "error": error,
        "status": result.status.value,
        "probability": result.probability,
        **{key: value for key, value in result.evidence.items() if value is None or np.isfinite(value)},
    }


def rows(places: list[Place], n_cross: int, seed: int, folder: Path) -> list[dict[str, object]]:
    """Register pairs of one place, then of different ones; rows already in the folder are not made again."""
    rng, found = np.random.default_rng(seed), {place.name: (mapped(place, folder), place) for place in places}
    asked = {place.name: place.name for place in places if not place.name.startswith("uniform")}
    for _ in range(n_cross):
        while True:
            i, j = rng.choice(len(places), 2)
            if places[i].site != places[j].site:
                break
        a, b = rng.integers(2, size=2)
        asked[f"{places[i].name}[{a}] / {places[j].name}[{b}]"] = (places[i].name, a, places[j].name, b)

    def make(name: str) -> dict[str, object]:
        if " / " in name:
            base, a, target, b = asked[name]
            return row_of(name, mm.register(found[base][0][a], found[target][0][b], SETTINGS), False)
        maps, place = found[name]
        result = mm.register(*maps, SETTINGS)
        distance, angle = pose_error(result, place.T_base_target, place.pair[1].centroid)
        is_right = distance < place.max_m and np.degrees(angle) < MAX_DEG
        return row_of(name, result, is_right, (distance, angle, nees_of(result, place.T_base_target)))

    return list(kept(folder / "rows.jsonl", asked, make).values())


def fit(data: list[dict[str, object]]) -> np.ndarray:
    """Weights of the logistic model, by maximum likelihood with a weak Gaussian prior (standard deviation 5)."""
    X = np.array([features(*statistics(r)) for r in data])
    y = np.array([r["is_right"] for r in data], dtype=float)

    def loss(w: np.ndarray) -> float:
        z = X @ w
        return float((np.logaddexp(0, z) - y * z).sum() + 0.5 * (w**2).sum() / 25)

    return np.asarray(minimize(loss, np.zeros(X.shape[1]), method="BFGS").x)


def statistics(row: dict[str, object]) -> tuple[float, float | None, float, float]:
    """Arguments of `features` in a row."""
    return row["log_odds"], row["decoy_log_odds"], row["misfit"], row["agreeing_share"]  # type: ignore[return-value]


def kind_of(row: dict[str, object]) -> str:
    """Rooms by what is done to them, recordings by their name."""
    words = str(row["name"]).split("-")
    return words[0] if words[0] in ("cea", "aalto", "jidling") else "-".join(words[:-1])


def print_kind(kind: str, rows: list[dict[str, object]]) -> None:
    """One line: successes, the best pose's error over all pairs, and mean NEES of what is accepted."""
    distance, angle, nees = np.array([r["error"] for r in rows], dtype=float).T
    is_right, is_in = (np.array([test(r) for r in rows]) for test in (_is_right, _is_accepted))
    errors = [
        [np.quantile(values, q, method="higher") for values in (1e3 * distance, np.degrees(angle))]
        for q in (0.5, 0.95)
    ]
    columns = " ".join(f"{mm:8.1f} / {deg:6.2f}" for mm, deg in errors)
    counts = f"{len(rows):5d} {is_right.sum():6d} {(is_right & is_in).sum():13d} {(~is_right & is_in).sum():8d}"
    mean = nees[is_in].mean() if is_in.any() else np.nan
    print(f"{kind:20} {counts}  {columns} {mean:6.2f}")


def _is_right(row: dict[str, object]) -> bool:
    return bool(row["is_right"])


def _is_accepted(row: dict[str, object]) -> bool:
    """As the default settings have it; walks, which have no misfit, are judged by limits of their own."""
    is_enough = "misfit" not in row or float(row["log_odds"]) >= PRESETS["default"].decision.min_log_evidence  # type: ignore[arg-type]
    return row["status"] == "accepted" and is_enough


def report(data: list[dict[str, object]]) -> None:
    """Counts of right and wrong, accepted or not, and how often each stated probability was right."""
    cross = [r for r in data if " / " in str(r["name"])]
    same = [r for r in data if " / " not in str(r["name"])]
    accepted = [r["name"] for r in cross if _is_accepted(r)]
    print(f"different places: {len(cross)} pairs, {len(accepted)} accepted {accepted}")
    print("kind                 pairs  right  and accepted  wrongly  median mm / deg    95 % mm / deg   NEES")
    for kind in dict.fromkeys(kind_of(r) for r in same):
        print_kind(kind, [r for r in same if kind_of(r) == kind])
    wrong = [r["name"] for r in same if _is_accepted(r) and not _is_right(r)]
    both = sum(_is_right(r) and _is_accepted(r) for r in same)
    print(
        f"one place: {len(same)} pairs, {sum(map(_is_right, same))} right, {both} of them accepted; wrongly: {wrong}"
    )
    print("stated probability   pairs   right   mean stated")
    stated = [r for r in data if r["probability"] is not None]
    p = np.array([r["probability"] for r in stated], dtype=float)
    y = np.array([r["is_right"] for r in stated])
    for low, high in ((0, 0.02), (0.02, 0.1), (0.1, 0.3), (0.3, 0.7), (0.7, 0.9), (0.9, 0.98), (0.98, 1.0001)):
        rows = (p >= low) & (p < high)
        if rows.any():
            means = y[rows].mean(), p[rows].mean()
            print(f"{low:5.2f} to {min(high, 1):4.2f}       {rows.sum():5d}   {means[0]:5.3f}   {means[1]:5.3f}")


def main() -> None:
    asked = arguments(__doc__, out=Path, first=2000, seeds=3, areas=5, cross=400, recordings=None, fit=False)
    asked.out.mkdir(parents=True, exist_ok=True)
    places = [*simulated(asked.first, asked.seeds), *recorded(asked.recordings, asked.areas, asked.first)]
    data = rows(places, asked.cross, asked.first, asked.out)
    report(data)
    if asked.fit:
        weighed = [r for r in data if r.get("log_odds") is not None and r.get("misfit") is not None]
        print("weights", np.round(fit(weighed), 2).tolist())


if __name__ == "__main__":
    main()
