"""One short survey against many places: CEA, simulated corridors and rooms, and recordings, all in one folder.

    python benchmarks/experiments/many_buildings.py FOLDER [--buildings 100] [--rooms 0] [--others] [--among 0]
        [--tries 50] [--simulated 50] [--absent 0] [--lengths 10] [--from DIR] [--seed 700] [--save NAME]

FOLDER keeps the maps and their indexes from run to run; other maps in it are places, too. A simulated building is a
corridor around a rectangle of its own size, walked twice along either side; a room is one of `many_rooms.py`; CEA
is walk one through both floors, and ``--others`` adds the other recordings. Targets are stretches of CEA's walk two
(`--tries`) on its second floor, and walks along the middle of as many different simulated corridors (`--simulated`),
each in a random frame of its own. Right = the right place first, and in it within 0.25 m and 3 deg; elsewhere = in
another place, or more than 1 m off. ``--among 100 1000`` asks each target twice, among its own place and 99, and 999,
others (0: all). From the folder of so many further targets of each kind (``--absent``) their own place is taken out,
so that nothing is right. Seconds are per query in one process with the folder open; those of opening it are printed
besides.
"""

import argparse
import time
from collections import Counter
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass, replace
from functools import partial
from itertools import islice, product
from pathlib import Path

import numpy as np
from many_rooms import room, rooms
from short_walks import MAX_DEG, MAX_M, OTHER_PLACE_M, stretches

import magmatch as mm
from magmatch.data.recordings import load_recordings
from magmatch.field.config import SPLINE
from magmatch.geometry import random_transform
from magmatch.simulation.magnets import Source, field_of
from magmatch.simulation.paths import around_loop, heading_along, loop_length
from magmatch.simulation.structures import along_corridor, calibrated, is_clear
from magmatch_evaluation.saved_table import saver, show
from magmatch_evaluation.script import arguments, pose_error, timed

HALF_WIDTH, HEIGHT, CORNER, CLEARANCE = 1.5, 1.2, 1.5, 0.5
LANES = (-0.35, 0.35)
# Rooms' seeds begin here. Of the other recordings one each of a place: walks, an area, a volume, a floor.
FIRST_ROOM = 700_000
OTHERS = {
    "kok": {"eight", "square", "library", "mall"},
    "aalto": {"invensense-1"},
    "jidling": {"volume"},
    "kaist": {"floor"},
}
# Buildings that are large: a map of one takes twice as long.
N_LARGE = 120
STEP, NOISE_SD, ANOMALY_SD = 0.08, 0.4e-6, 12e-6
EARTH = np.array([17.83e-6, 0.0, -44.57e-6])
COLUMNS = (
    "target", "places", "n", "right building first", "and right pose", "accepted and right",
    "accepted, out of tolerance", "accepted elsewhere", "refused", "s a query, one core",
)  # fmt: skip


@dataclass(frozen=True)
class Building:
    """A corridor around a rectangle."""

    size: tuple[float, float]
    sources: tuple[Source, ...]

    @classmethod
    def of(cls, number: int) -> "Building":
        """The building of a number, always the same; those after the first hundred are half as long and wide."""
        rng = np.random.default_rng([4242, number])
        scale = 1.0 if number < N_LARGE else 0.5
        size = (scale * float(rng.uniform(12, 22)), scale * float(rng.uniform(7, 12)))
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


def surveys(asked: argparse.Namespace, cea: mm.Survey) -> Iterator[tuple[str, Callable[[], mm.Survey]]]:
    """Names of all places, and what makes their surveys."""
    for number in range(asked.buildings - 1):
        yield f"building-{number:03d}", partial(building_survey, number)
    yield "cea", lambda: cea
    for name in islice(rooms(FIRST_ROOM, asked.rooms), asked.rooms):
        yield f"{name}.base", lambda name=name: room(name).base
    if asked.others:
        for source, names in OTHERS.items():
            for name, survey in load_recordings(source, asked.recordings).items():
                if name in names:
                    yield f"{source}-{name}", lambda survey=survey: survey


def make_maps(folder: Path, places: Iterable[tuple[str, Callable[[], mm.Survey]]]) -> None:
    """Build the maps that are not there yet."""
    folder.mkdir(parents=True, exist_ok=True)
    start, n_built = time.perf_counter(), 0
    for name, make in places:
        path = folder / f"{name}.map"
        if not path.exists():
            mm.build_map(make(), SPLINE).save(path)
            n_built += 1
    print(f"{n_built} maps built in {time.perf_counter() - start:.0f} s")


def building_survey(number: int) -> mm.Survey:
    """A building's survey; each has a frame of its own."""
    rng = np.random.default_rng([1, number])
    survey = Building.of(number).surveyed(rng)
    return survey.transformed(random_transform(rng))


def simulated_target(number: int, length: float, rng: np.random.Generator) -> tuple[mm.Survey, mm.Survey]:
    """A walk along the middle of a corridor, in the frame of the building's map."""
    building = Building.of(number)
    start = rng.uniform(0, loop_length(building.size, CORNER))
    walk = building.measured(building.path(rng.uniform(-0.2, 0.2), start=start, length=length), rng)
    again = np.random.default_rng([1, number])
    building.surveyed(again)
    return walk.transformed(random_transform(again))


def among(atlas: mm.Atlas, n: int, name: str, *, is_absent: bool) -> mm.Atlas:
    """A place among others, n in all, and the same others for all places but those."""
    others = [entry for entry in atlas.entries if entry.name != name]
    chosen = np.random.default_rng(len(others)).permutation(len(others))[: n - 1 if n else None]
    kept = {others[k].name for k in chosen} | (set() if is_absent else {name})
    return replace(atlas, entries=tuple(entry for entry in atlas.entries if entry.name in kept))


def judge(atlas: mm.Atlas, sizes: list[int], target: mm.Survey, name: str, rng: np.random.Generator, *,
          is_absent: bool) -> list[tuple]:  # fmt: skip
    """Localise one target from a random frame, among each number of places."""
    T_base_target = random_transform(rng)
    moved, found = target.transformed(T_base_target.inv()), []
    for n in sizes:
        result, *seconds = timed(mm.register, among(atlas, n, name, is_absent=is_absent), moved)
        distance, angle = pose_error(result, T_base_target, moved.centroid)
        is_right = result.base == name and distance <= MAX_M and np.degrees(angle) <= MAX_DEG
        is_elsewhere = result.base != name or distance > OTHER_PLACE_M
        accepted = (result.is_accepted and is_right, result.is_accepted and is_elsewhere, result.is_accepted)
        found.append((result.base == name, is_right, accepted, seconds, str(result.status), result.seconds))
    return found


def resident() -> str:
    """Memory of this process, MB: its own, and pages of files that are mapped, which others share."""
    lines = dict(line.split(":") for line in Path("/proc/self/status").read_text().splitlines() if "Rss" in line)
    return ", ".join(f"{key} {int(lines[key].split()[0]) / 1024:.0f} MB" for key in ("RssAnon", "RssFile"))


def report(name: str, n_places: int, outcomes: Sequence[tuple], *, is_absent: bool) -> list[str]:
    """One row; refusals and seconds are told beside it."""
    of_building, right, accepted, seconds, status, stages = zip(*outcomes, strict=True)
    good, elsewhere, n_accepted = np.sum(accepted, axis=0).tolist()
    median, high = np.quantile(seconds, (0.5, 0.95), axis=0)
    print(
        f"{name}, {n_places} places: {dict(Counter(status))}; seconds per query: median {median[0]:.2f}, 95 % "
        f"{high[0]:.2f}, votes {np.median([s.get('votes', np.nan) for s in stages]):.2f}",
        flush=True,
    )
    found = ["-"] * 3 if is_absent else [str(sum(of_building)), str(sum(right)), str(good)]
    n = len(outcomes)
    wrong = [str(n_accepted - good - elsewhere), str(elsewhere), str(n - n_accepted)]
    return [name, str(n_places), str(n), *found, *wrong, f"{median[1]:.2f}"]


def targets(asked: argparse.Namespace, walk: mm.Survey, length: float, *, is_absent: bool) -> Iterator[tuple]:
    """Kinds of targets, each with its targets and their places."""
    rng = np.random.default_rng([asked.seed, int(length), is_absent])
    tries, simulated = (asked.absent,) * 2 if is_absent else (asked.tries, asked.simulated)
    some = stretches(walk, length, tries, rng)
    yield f"CEA floor 2, {length:.0f} m", (("cea.map", stretch) for stretch in some)
    numbers = rng.choice(asked.buildings - 1, min(simulated, asked.buildings - 1), replace=False)
    walks = ((f"building-{k:03d}.map", simulated_target(int(k), length, rng)) for k in numbers)
    yield f"simulated, {length:.0f} m along the middle", walks


def main() -> None:
    asked = arguments(
        __doc__, (), recordings=None, buildings=100, rooms=0, others=False, among=[0], tries=50, simulated=50,
        absent=0, lengths=[10.0], seed=700, save=saver,
    )  # fmt: skip
    folder = Path(asked.words[0])
    walks = load_recordings("cea", asked.recordings)
    make_maps(folder, surveys(asked, walks["training"]))
    indexing = timed(mm.open_atlas, folder).clock
    before = resident()
    atlas, opening, _ = timed(mm.open_atlas, folder)
    size = sum(path.stat().st_size for path in folder.iterdir())
    print(f"{len(atlas.entries)} places, {size / 1e6:.0f} MB; indexed in {indexing:.1f} s, opened again in "
          f"{opening:.2f} s; resident {before}, open {resident()}")  # fmt: skip
    rows = []
    for length, is_absent in product(asked.lengths, (False, True)):
        rng = np.random.default_rng([asked.seed, int(length), 2 + is_absent])
        for kind, some in targets(asked, walks["test-floor2"], length, is_absent=is_absent):
            found = [judge(atlas, asked.among, s, name, rng, is_absent=is_absent) for name, s in some]
            name = f"{kind}, its place taken out" if is_absent else kind
            for n, outcomes in zip(asked.among, zip(*found, strict=True), strict=False):
                rows.append(report(name, n or len(atlas.entries), outcomes, is_absent=is_absent))
    print(f"resident {resident()}")
    show(COLUMNS, rows, asked.save)


if __name__ == "__main__":
    main()
