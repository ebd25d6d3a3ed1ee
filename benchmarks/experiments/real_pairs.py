"""Register pairs cut from public recordings; print success, error and time of each.

    python benchmarks/experiments/real_pairs.py [--from DIR] [--areas 10] [--seed 100] [--preset default]

Both surveys of a pair lie in one frame; a random SE(3) is applied to the target's positions and vectors, so the
truth is known up to the recordings' own accuracy. Success = accepted and within the tolerance of the group.
"""

import argparse
import time
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np

import magmatch as mm
from magmatch.data.recordings import load_recordings
from magmatch.data.survey import Survey
from magmatch.geometry import random_transform, transform_error
from magmatch.registration.config import PRESETS

LOCAL = Path(__file__).resolve().parents[2].parent / "shared" / "data"


@dataclass(frozen=True)
class Pair:
    """Two surveys in one frame, and how far the answer may be off."""

    group: str
    name: str
    base: Survey
    target: Survey
    max_m: float
    max_deg: float


def cea_areas(source: Path | None, n: int, seed: int, floor: int) -> Iterator[Pair]:
    """Square areas of 10 to 20 m of one floor, walk one against walk two, centred on the walk."""
    walks = load_recordings("cea", source)
    one, two = walks[f"training-floor{floor}"], walks[f"test-floor{floor}"]
    rng, found = np.random.default_rng(seed), 0
    while found < n:
        center, side = two.positions[rng.integers(len(two)), :2], rng.uniform(10, 20)
        cut = [s.subset(np.all(np.abs(s.positions[:, :2] - center) < side / 2, axis=1)) for s in (one, two)]
        if min(len(c) for c in cut) < 300:
            continue
        yield Pair(f"cea floor {floor}", f"{side:.0f} m at ({center[0]:.0f}, {center[1]:.0f})", *cut, 0.25, 3.0)
        found += 1


def aalto_runs(source: Path | None) -> Iterator[Pair]:
    """Horizontal against vertical boustrophedon of one robot, within and across its two sensors."""
    runs = load_recordings("aalto", source)
    for one in ("invensense", "trivisio"):
        for two in ("invensense", "trivisio"):
            yield Pair("aalto 1-2", f"{one}-1 / {two}-2", runs[f"{one}-1"], runs[f"{two}-2"], 0.10, 3.0)
    for run in "12":
        yield Pair("aalto 4", f"invensense-{run} / 4", runs[f"invensense-{run}"], runs["invensense-4"], 0.10, 3.0)


def laps(source: Path | None) -> Iterator[Pair]:
    """First half of a recording against its second half."""
    for dataset, names, max_m in (("kok", ("eight", "square", "library"), 0.4), ("jidling", ("volume",), 0.06)):
        surveys = load_recordings(dataset, source)
        for name in names:
            s = surveys[name]
            half = np.arange(len(s)) < len(s) // 2
            yield Pair(f"{dataset} halves", name, s.subset(half), s.subset(~half), max_m, 3.0)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--from", dest="source", type=Path, default=LOCAL if LOCAL.is_dir() else None)
    parser.add_argument("--areas", type=int, default=10)
    parser.add_argument("--seed", type=int, default=100)
    parser.add_argument("--preset", choices=sorted(PRESETS), default="default")
    arguments = parser.parse_args()
    pairs = [
        *cea_areas(arguments.source, arguments.areas, arguments.seed, 1),
        *cea_areas(arguments.source, arguments.areas, arguments.seed, 2),
        *aalto_runs(arguments.source),
        *laps(arguments.source),
    ]
    outcome: dict[str, list[bool]] = {}
    for k, pair in enumerate(pairs):
        T_base_target = random_transform(np.random.default_rng([arguments.seed, k]))
        target = pair.target.transformed(T_base_target.inv())
        start = time.perf_counter()
        result = mm.register(pair.base, target, PRESETS[arguments.preset])
        seconds = time.perf_counter() - start
        best = result.T_base_target
        if best is None and result.alternatives:
            best = result.alternatives[0].T_base_target
        distance, angle = np.inf, np.inf
        if best is not None:
            distance, angle = transform_error(best, T_base_target, target.centroid)
        is_right = distance <= pair.max_m and np.degrees(angle) <= pair.max_deg
        outcome.setdefault(pair.group, []).append(bool(is_right and result.is_accepted))
        print(
            f"{pair.group:12s} {pair.name:28s} n {len(pair.base):5d} {len(pair.target):5d}  {result.status:13s} "
            f"{'right' if is_right else 'WRONG'}  {1e3 * distance:7.0f} mm {np.degrees(angle):6.2f} deg"
            f"  {seconds:5.2f} s  | {result.reason}",
            flush=True,
        )
    for group, successes in outcome.items():
        print(f"{group:14s} success {sum(successes)} of {len(successes)}")


if __name__ == "__main__":
    main()
