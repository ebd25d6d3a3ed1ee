"""One short walk against many buildings: CEA hidden among simulated ones.

    python benchmarks/experiments/many_buildings.py FOLDER [--buildings 100] [--tries 50] [--lengths 10]
        [--simulated 50] [--from DIR] [--seed 700] [--floor 2]

FOLDER keeps the maps and their indexes from run to run. A simulated building is a corridor around a rectangle of its
own size, walked twice along either side; CEA is walk one through both floors. Targets are stretches of CEA's walk
two (`--tries`) and walks along the middle of as many different simulated corridors (`--simulated`), each in a random
frame of its own. Right = the right building first, and in it within 0.25 m and 3 deg. With ``--absent`` each target's
own building is taken out of the atlas, so that nothing is right. Seconds are per query in one process with the atlas
open; those of opening it are printed besides.
"""

import time
from collections import Counter
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path

import numpy as np
from short_walks import MAX_DEG, MAX_M, stretches

import magmatch as mm
from magmatch.data.recordings import load_recordings
from magmatch.geometry import random_transform
from magmatch.simulation.magnets import Source, field_of
from magmatch.simulation.paths import around_loop, heading_along, loop_length
from magmatch.simulation.structures import along_corridor, calibrated, is_clear
from magmatch_evaluation.script import arguments, pose_error, timed

HALF_WIDTH, HEIGHT, CORNER, CLEARANCE = 1.5, 1.2, 1.5, 0.5
LANES = (-0.35, 0.35)
STEP, NOISE_SD, ANOMALY_SD = 0.08, 0.4e-6, 12e-6
EARTH = np.array([17.83e-6, 0.0, -44.57e-6])


@dataclass(frozen=True)
class Building:
    """A corridor around a rectangle."""

    size: tuple[float, float]
    sources: tuple[Source, ...]

    @classmethod
    def of(cls, number: int) -> "Building":
        """The building of a number, always the same."""
        rng = np.random.default_rng([4242, number])
        size = (float(rng.uniform(12, 22)), float(rng.uniform(7, 12)))
        length = loop_length(size, CORNER)
        sources = along_corridor(partial(around_loop, size, CORNER), length, HALF_WIDTH, rng)
        building = cls(size, ())
        probes = np.concatenate([building.path(side, 0.5) for side in (*LANES, 0.0)])
        sources = [source for source in sources if is_clear([source], probes, CLEARANCE).all()]
        return cls(size, tuple(calibrated(sources, probes, ANOMALY_SD)))

    def path(self, side: float, step: float = STEP, start: float = 0.0, length: float | None = None) -> np.ndarray:
        """Walk along the corridor, so far left of its middle."""
        length = loop_length(self.size, CORNER) if length is None else length
        positions, _ = around_loop(self.size, CORNER, start + np.arange(0, length, step))
        heading = heading_along(positions)
        positions += side * np.column_stack([-np.sin(heading), np.cos(heading), 0 * heading])
        positions[:, 2] = HEIGHT
        return positions

    def measured(self, positions: np.ndarray, rng: np.random.Generator) -> mm.Survey:
        """A sensor carried along a path by a hand that wavers."""
        positions = positions + np.cumsum(0.005 * rng.standard_normal(positions.shape), axis=0) * [0.3, 0.3, 0.1]
        field = field_of(self.sources, positions) + EARTH
        return mm.Survey(positions, field + NOISE_SD * rng.standard_normal(field.shape))

    def surveyed(self, rng: np.random.Generator) -> mm.Survey:
        """All lanes of the corridor."""
        return self.measured(np.concatenate([self.path(side) for side in LANES]), rng)


def make_maps(folder: Path, n: int, cea: mm.Survey) -> None:
    """Build the maps that are not there yet."""
    folder.mkdir(parents=True, exist_ok=True)
    start, n_built = time.perf_counter(), 0
    for number in range(n - 1):
        path = folder / f"building-{number:03d}.map"
        if not path.exists():
            rng = np.random.default_rng([1, number])
            survey = Building.of(number).surveyed(rng)
            # Each building has a frame of its own.
            mm.build_map(survey.transformed(random_transform(rng))).save(path)
            n_built += 1
    if not (folder / "cea.map").exists():
        mm.build_map(cea).save(folder / "cea.map")
        n_built += 1
    print(f"{n_built} maps built in {time.perf_counter() - start:.0f} s")


def simulated_target(number: int, length: float, rng: np.random.Generator) -> tuple[mm.Survey, mm.Survey]:
    """A walk along the middle of a corridor, in the frame of the building's map."""
    building = Building.of(number)
    start = rng.uniform(0, loop_length(building.size, CORNER))
    walk = building.measured(building.path(rng.uniform(-0.2, 0.2), start=start, length=length), rng)
    again = np.random.default_rng([1, number])
    building.surveyed(again)
    return walk.transformed(random_transform(again))


def judge(atlas: mm.Atlas, target: mm.Survey, name: str, rng: np.random.Generator, *, is_absent: bool) -> tuple:
    """Localise one target from a random frame."""
    T_base_target = random_transform(rng)
    moved = target.transformed(T_base_target.inv())
    if is_absent:
        atlas = replace(atlas, entries=tuple(entry for entry in atlas.entries if entry.name != name))
    result, *seconds = timed(mm.localize, atlas, moved)
    distance, angle = pose_error(result, T_base_target, moved.centroid)
    is_right = result.base == name and distance <= MAX_M and np.degrees(angle) <= MAX_DEG
    return result.base == name, is_right, result.is_accepted, seconds, str(result.status), result.seconds


def report(name: str, length: float, outcomes: list[tuple]) -> None:
    of_building, right, accepted, seconds, status, stages = zip(*outcomes, strict=True)
    n = len(outcomes)
    print(
        f"{name} {length:.0f} m: {n} tries, right building first {sum(of_building)}, and right pose {sum(right)} "
        f"({sum(right) / n:.0%}), accepted and right {sum(r and a for r, a in zip(right, accepted, strict=True))}, "
        f"accepted and wrong {sum(a and not r for r, a in zip(right, accepted, strict=True))}; "
        f"{dict(Counter(status))}\n    seconds per query: median {np.median(seconds, axis=0)[0]:.2f}, "
        f"95 % {np.quantile(seconds, 0.95, axis=0)[0]:.2f} (of one core: {np.median(seconds, axis=0)[1]:.2f}), votes "
        f"{np.median([s.get('votes', np.nan) for s in stages]):.2f}",
        flush=True,
    )


def main() -> None:
    asked = arguments(
        __doc__, (), recordings=None, buildings=100, tries=50, simulated=50, lengths=[10.0], seed=700, floor=2,
        absent=False,
    )  # fmt: skip
    folder = Path(asked.words[0])
    walks = load_recordings("cea", asked.recordings)
    make_maps(folder, asked.buildings, walks["training"])
    indexing = timed(mm.open_atlas, folder).clock
    atlas, opening, _ = timed(mm.open_atlas, folder)
    print(f"indexed in {indexing:.1f} s, opened again in {opening:.2f} s")
    atlas = replace(atlas, entries=atlas.entries[: asked.buildings - 1] + atlas.entries[-1:])
    for length in asked.lengths:
        rng = np.random.default_rng([asked.seed, int(length)])
        run = partial(judge, rng=rng, is_absent=asked.absent)
        walk = walks[f"test-floor{asked.floor}"]
        real = [run(atlas, s, "cea.map") for s in stretches(walk, length, asked.tries, rng)]
        report(f"CEA floor {asked.floor}", length, real) if real else None
        numbers = rng.choice(len(atlas.entries) - 1, min(asked.simulated, len(atlas.entries) - 1), replace=False)
        made = [run(atlas, simulated_target(int(k), length, rng), f"building-{k:03d}.map") for k in numbers]
        report("simulated", length, made) if made else None


if __name__ == "__main__":
    main()
