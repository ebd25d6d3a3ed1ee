# SPDX-License-Identifier: BSD-3-Clause
"""Slam of long walks: time and memory by path length, and where the poses end up.

Routes: *grid*, corridors between 5 x 5 junctions 30 m apart, at each of which the walk turns at random, never back;
*laps*, a loop of 1.2 km walked again and again, so that nothing is passed twice for the first 1.2 km. Odometry of one
per cent as in `slam_scenarios`, ten samples a metre, 0.4 uT of noise; slam is told nothing of it. Seconds are of the
processor; beside them, in the same run, the registration of two rooms of 2,500 samples each, which a metre of path is
compared with. Each walk is worked on in a process of its own, whose peak memory is stated.

Run: PYTHONPATH=benchmarks/experiments python benchmarks/bench_slam_long.py [--kilometres 1 3 10] [--routes grid laps]
    [--seed 0] [--save NAME]
"""

import json

import numpy as np
from scipy.spatial import cKDTree
from scipy.spatial.transform import RigidTransform, Rotation
from slam_scenarios import CORRIDOR, EARTH, aligned_rms, at_nodes, drifted, nees_of, off_truth

import magmatch as mm
from magmatch.geometry import path_walked
from magmatch.simulation.magnets import Source, field_of
from magmatch.simulation.paths import around_loop, heading_along, loop_length, resample, smooth_noise
from magmatch.simulation.structures import along_corridor, calibrated, is_clear
from magmatch_evaluation.saved_table import saver, show
from magmatch_evaluation.script import alone, arguments, peak_mib, timed

COLUMNS = (
    "route", "km", "odometry, m", "corrected, m", "NEES", "closures", "over 1 m off and kept", "processor, s",
    "clock, s", "of a registration, a metre", "peak, MiB",
)  # fmt: skip
STEP, JUNCTIONS, APART, LAP = 0.1, 5, 30.0, (380.0, 222.0)
# Sources farther than this from a stretch of path change its field by less than the noise; stretches, samples.
FAR, STRETCH = 25.0, 200


def streets(kilometres: float, rng: np.random.Generator) -> tuple[np.ndarray, list[Source]]:
    """A walk through a grid of corridors, and what stands along these."""
    at, ahead, corners = np.array([0, 0]), np.array([1, 0]), [np.zeros(2)]
    while len(corners) * APART < 1000 * kilometres + APART:
        left = np.array([-ahead[1], ahead[0]])
        ways = [w for w in (ahead, left, -left) if np.all((at + w >= 0) & (at + w < JUNCTIONS))]
        ahead = ways[rng.integers(len(ways))]
        at = at + ahead
        corners.append(APART * at)
    path = resample(np.column_stack([np.array(corners), np.zeros(len(corners))]), int(1000 * kilometres / STEP))
    sources: list[Source] = []
    for k in range(JUNCTIONS):
        for turn in (0.0, np.pi / 2):
            length = APART * (JUNCTIONS - 1)

            def place(s: np.ndarray, k: int = k, turn: float = turn) -> tuple[np.ndarray, np.ndarray]:
                along = np.column_stack([s, np.full(len(s), k * APART), np.zeros(len(s))])
                return along[:, [1, 0, 2]] if turn else along, np.full(len(s), turn)

            sources += along_corridor(place, length, 1.0, rng)
    return path, sources


def laps(kilometres: float, rng: np.random.Generator) -> tuple[np.ndarray, list[Source]]:
    """A walk around one large loop, and what stands along it."""
    path, _ = around_loop(LAP, 1.0, np.arange(0, 1000 * kilometres, STEP))
    return path, along_corridor(lambda s: around_loop(LAP, 1.0, s), loop_length(LAP, 1.0), 1.0, rng)


def walk(route: str, kilometres: float, seed: int) -> tuple[mm.Survey, np.ndarray]:
    """A log with drifting odometry, and its true path."""
    rng = np.random.default_rng([seed, len(route)])
    path, sources = {"grid": streets, "laps": laps}[route](kilometres, rng)
    ahead = heading_along(path)
    beside = smooth_noise(len(path), 25, 0.15, rng)
    path += beside[:, None] * np.column_stack([-np.sin(ahead), np.cos(ahead), 0 * ahead]) + [0, 0, 0.5]
    some = cKDTree(path[::5])
    sources = [s for s in sources if is_clear([s], path[::5][some.query_ball_point(s.center, 4.0)], 0.25).all()]
    sources = calibrated(sources, path[:: max(len(path) // 400, 1)], 6e-6)
    near = cKDTree([s.center for s in sources])
    field = np.tile(EARTH, (len(path), 1))
    for rows in np.array_split(np.arange(len(path)), max(len(path) // STRETCH, 1)):
        middle = path[rows].mean(axis=0)
        reach = FAR + np.linalg.norm(path[rows] - middle, axis=1).max()
        field[rows] += field_of([sources[k] for k in near.query_ball_point(middle, reach)], path[rows])
    return drifted(path, field, 1.0, rng), path


def room() -> float:
    """Seconds of the processor for the registration of two rooms of 2,500 samples, loops compiled: median of five."""
    rng = np.random.default_rng(0)
    low, high = np.array([-3.0, -2.5, 0.3]), np.array([3.0, 2.5, 1.7])
    sources = along_corridor(lambda s: around_loop(CORRIDOR, 1.0, s), loop_length(CORRIDOR, 1.0), 1.0, rng)
    sources = [s for s in sources if np.any((s.center < low - 0.3) | (s.center > high + 0.3))]

    def survey() -> mm.Survey:
        points = rng.uniform(low, high, (2500, 3))
        return mm.Survey(points, field_of(sources, points) + EARTH + 4e-7 * rng.standard_normal((2500, 3)))

    base, target = survey(), survey()
    T = RigidTransform.from_components([1.0, 2.0, 0.5], Rotation.from_rotvec([0.3, -0.5, 1.0]))
    target = target.transformed(T.inv())
    mm.register(base, target)
    return float(np.median([timed(mm.register, base, target).processor for _ in range(5)]))


def work(route: str, kilometres: float, seed: int) -> dict[str, object]:
    log, path = walk(route, kilometres, seed)
    registration = room()
    session, clock, processor = timed(mm.slam, log)
    p, turned = at_nodes(session, path)
    off = off_truth(session, p, turned)
    wrong = sum(bool(c.is_kept) and o > 1 for o, c in zip(off, session.graph.closures, strict=True))
    after = session.trajectories[0].positions
    return {
        "length": float(path_walked(path)[-1]), "before": aligned_rms(log.positions[:, :2], path[:, :2]),
        "after": aligned_rms(after[:, :2], path[:, :2]), "nees": nees_of(session, p, turned), "closures": len(off),
        "wrong": wrong, "processor": processor, "clock": clock, "room": registration, "peak": peak_mib(),
    }  # fmt: skip


def main() -> None:
    asked = arguments(__doc__, [], kilometres=[1.0, 3.0, 10.0], routes=["grid", "laps"], seed=0, save=saver)
    if asked.words:
        route, kilometres = asked.words
        print(json.dumps(work(route, float(kilometres), asked.seed)))
        return
    table = []
    for route in asked.routes:
        for kilometres in asked.kilometres:
            r = alone(__file__, route, kilometres, "--seed", asked.seed)
            table.append([
                route, f"{r['length'] / 1000:.1f}", f"{r['before']:.2f}", f"{r['after']:.2f}", f"{r['nees']:.1f}",
                r["closures"], r["wrong"], f"{r['processor']:.0f}", f"{r['clock']:.0f}",
                f"1/{r['room'] / (r['processor'] / r['length']):.0f}", f"{r['peak']:.0f}",
            ])  # fmt: skip
            print(" ".join(map(str, table[-1])), flush=True)
    show(COLUMNS, table, asked.save)


if __name__ == "__main__":
    main()
