"""Try to register surveys of different places; print what was accepted wrongly and the strongest evidence seen.

    python benchmarks/experiments/different_places.py [--pairs 100] [--seed 100] [--from DIR]

Half of the pairs are cut from public recordings (areas of a building more than 15 m or a floor apart, recordings of
different buildings), half are simulated rooms that share nothing (scenario ``nowhere``).
"""

import argparse
from pathlib import Path

import numpy as np
from scipy.spatial import cKDTree

import magmatch as mm
from magmatch.data.recordings import load_recordings
from magmatch.data.survey import Survey
from magmatch.geometry import random_transform

LOCAL = Path(__file__).resolve().parents[2].parent / "shared" / "data"


def real_areas(source: Path | None, rng: np.random.Generator) -> list[tuple[str, str, Survey]]:
    """Areas of 8 to 15 m of each large recording, whole recordings where they are small: (place, name, survey)."""
    areas = []
    for dataset, names in (
        ("cea", ("training-floor1", "test-floor2")),
        ("kok", ("eight", "square", "library", "mall")),
        ("aalto", ("invensense-1",)),
    ):
        surveys = load_recordings(dataset, source)
        for name in names:
            s = surveys[name]
            for _ in range(12 if len(s) > 5000 else 4):
                center, side = s.positions[rng.integers(len(s)), :2], rng.uniform(8, 15)
                cut = s.subset(np.all(np.abs(s.positions[:, :2] - center) < side / 2, axis=1))
                if len(cut) >= 100:
                    areas.append((dataset if dataset == "cea" else f"{dataset} {name}", name, cut))
    return areas


def real_pairs(source: Path | None, n: int, rng: np.random.Generator) -> list[tuple[str, Survey, Survey]]:
    """Pairs of areas that have no point in common within 3 m."""
    areas, pairs = real_areas(source, rng), []
    while len(pairs) < n:
        i, j = rng.choice(len(areas), 2, replace=False)
        (place, name, base), (other_place, other_name, target) = areas[i], areas[j]
        is_near = cKDTree(base.positions).query(target.positions)[0].min() < 3
        if place == other_place and is_near:
            continue
        pairs.append((f"{name} / {other_name}", base, target.transformed(random_transform(rng))))
    return pairs


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--pairs", type=int, default=100)
    parser.add_argument("--seed", type=int, default=100)
    parser.add_argument("--from", dest="source", type=Path, default=LOCAL if LOCAL.is_dir() else None)
    arguments = parser.parse_args()
    rng = np.random.default_rng(arguments.seed)
    pairs = real_pairs(arguments.source, arguments.pairs // 2, rng)
    for k in range(arguments.pairs - len(pairs)):
        simulated = mm.simulate("nowhere", arguments.seed + k)
        pairs.append(("simulated nowhere", simulated.base, simulated.target))
    statuses: dict[str, int] = {}
    for name, base, target in pairs:
        result = mm.register(base, target)
        statuses[result.status] = statuses.get(result.status, 0) + 1
        if result.is_accepted:
            print(f"ACCEPTED  {name}: {result.reason}", flush=True)
    print(f"{len(pairs)} pairs of different places: {statuses.get('accepted', 0)} accepted; {statuses}")


if __name__ == "__main__":
    main()
