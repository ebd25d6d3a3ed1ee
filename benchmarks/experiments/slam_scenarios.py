"""Simulated logs whose odometry drifts, corrected by their field alone.

    python benchmarks/experiments/slam_scenarios.py --out DIR [--first 100] [--seeds 20] [--places corridor office
        hall table] [--passes 3 6] [--drifts 0.5 1 3] [--jobs 2] [--minutes N] [--save NAME]

Places: a corridor walked in laps, an office walked to and fro, a hall in lanes and then in lanes across them, a
robot in circles over a table of magnets; each passed three and six times, 0.4 uT of noise. Odometry of 0.5, 1 and
3 % (`LEVELS`): an error of scale, random walks of heading, place and height, and an attitude that swings; slam is
told nothing of it. Errors: rms of places after one rigid alignment in the plane; heading: rms about the mean. But for
scale: corrected ones after an alignment with a scale, which no revisit shows, to the same error of odometry. Ceiling:
true relative poses at every revisit. NEES is of nodes in the frame of the first, per degree of freedom. A closure is
wrong that is off by more than half a field length and three of its standard deviations; it survives where the graph
keeps it. Rows stay in DIR; a second run goes on where the first ended.
"""

import os
from pathlib import Path

import numpy as np
from localize_walks import LEVELS
from scipy.spatial.transform import RigidTransform, Rotation
from slam_walks import aligned_rms

import magmatch as mm
from magmatch.geometry import path_walked
from magmatch.simulation.config import SimulationConfig
from magmatch.simulation.magnets import field_of
from magmatch.simulation.paths import (
    around_loop,
    boustrophedon,
    circles,
    heading_along,
    loop_length,
    resample,
    smooth_noise,
    upright,
    wander,
)
from magmatch.simulation.structures import along_corridor, around_box, calibrated, is_clear, under_table
from magmatch.slam.graph.factors import Closure
from magmatch.slam.graph.pose_graph import APART
from magmatch.slam.graph.solve import solve
from magmatch.slam.graph.trajectories import corrected
from magmatch_evaluation.saved_table import saver, show
from magmatch_evaluation.script import arguments, in_groups, kept, timed

PLACES, PASSES, DRIFTS = ("corridor", "office", "hall", "table"), (3, 6), (0.5, 1.0, 3.0)
EARTH = np.array(SimulationConfig().earth_field)
COLUMNS = (
    "place", "passes", "drift, %", "n", "odometry, m", "corrected, m", "median ratio", "worst ratio", "but for scale",
    "ceiling ratio", "heading ratio", "NEES", "closures", "wrong", "wrong that survive", "s a metre",
)  # fmt: skip
CORRIDOR = (20.0, 10.0)
NOISE = 4e-7
# Samples over which the attitude's errors swing.
SWING = 60


def place(name: str, passes: int, rng: np.random.Generator) -> tuple[np.ndarray, np.ndarray]:
    """True path (n, 3) and its field, T."""
    if name == "table":
        sources = under_table((2.0, 1.5), 0.08, 15, rng)
        path = circles(np.array([0.0, 0.0, 0.05]), (0.25, 0.4, 0.55), passes, 800 * passes)
    elif name == "corridor":
        length = loop_length(CORRIDOR, 1.0)
        path, heading = around_loop(CORRIDOR, 1.0, np.arange(0, passes * length, 0.06))
        beside = smooth_noise(len(path), 25, 0.15, rng)
        path += beside[:, None] * np.column_stack([-np.sin(heading), np.cos(heading), 0 * heading]) + [0, 0, 0.5]
        sources = along_corridor(lambda s: around_loop(CORRIDOR, 1.0, s), length, 1.0, rng)
    else:
        size = np.array([6.0, 5.0, 0.0]) if name == "office" else np.array([15.0, 10.0, 0.0])
        if name == "office":
            path = wander((size[0], size[1], 0.0), 1200 * passes, 0.02, rng)
            path = resample(path, int(path_walked(path)[-1] / 0.05))
        else:
            corners = [boustrophedon(-size / 2, size / 2, [0.0], 1.5, k % 2, 400) for k in range(passes)]
            path = np.concatenate(corners)
            path = resample(path, int(path_walked(path)[-1] / 0.07))
        low, high = np.array([*(-size[:2] / 2), -0.5]), np.array([*(size[:2] / 2), 1.5])
        sources = around_box(low, high, 0.3, rng, faces=range(4)) + around_box(low, high, 0.3, rng, faces=(4,))
    if name != "table":
        sources = [s for s in sources if is_clear([s], path[::10], 0.25).all()]
        sources = calibrated(sources, path[::10], 6e-6)
    return path, field_of(sources, path) + EARTH


def drifted(path: np.ndarray, field: np.ndarray, percent: float, rng: np.random.Generator) -> mm.Survey:
    """The log of a body that looks ahead and knows its path from drifting odometry, in the frame of its start."""
    scale_sd, heading_walk, place_walk, height_walk, lean_sd = LEVELS[f"{percent:g}%"]
    steps = np.diff(path, axis=0)
    walked, ahead = np.sqrt(np.linalg.norm(steps, axis=1)), heading_along(path)
    turned = np.concatenate([[0], np.cumsum(np.radians(heading_walk) * walked * rng.standard_normal(len(steps)))])
    scale = 1 + scale_sd * rng.standard_normal()
    moved = walked[:, None] * [place_walk, place_walk, height_walk] * rng.standard_normal((len(steps), 3))
    positions = np.cumsum(upright(turned[:-1]).apply(scale * steps) + moved, axis=0)
    positions = np.concatenate([np.zeros((1, 3)), positions])
    lean = [smooth_noise(len(path), SWING, np.radians(lean_sd), rng) for _ in range(2)]
    attitude = upright(turned) * Rotation.from_rotvec(np.column_stack([*lean, 0 * ahead]))
    measured = attitude.apply(field + NOISE * rng.standard_normal(field.shape))
    log = mm.Survey(
        positions, measured, times=path_walked(path), orientations=attitude * upright(ahead), name="walk.csv"
    )
    return log.transformed(RigidTransform.from_rotation(Rotation.from_euler("z", rng.uniform(-np.pi, np.pi))))


def heading_error(log: mm.Survey, truth: Rotation) -> float:
    """Rms of headings about their mean error, deg."""
    turn = (log.orientations * truth.inv()).as_rotvec()[:, 2]
    turn = np.angle(np.exp(1j * turn) * np.exp(-1j * np.angle(np.exp(1j * turn).mean())))
    return float(np.degrees(np.sqrt((turn**2).mean())))


def nees_of(session: mm.Session, p: np.ndarray, turned: Rotation) -> float:
    """Mean over nodes tied to the first of the squared error of place over its covariance, per degree of freedom.

    Of nodes at true places p, in axes that odometry had turned.
    """
    graph = session.graph
    tied = np.flatnonzero(graph.component() == graph.component()[0])[1:]
    e = (graph.p - graph.p[0] - turned[0].inv().apply(p - p[0]))[tied, :2]
    C = session.covariances_of_place(tied)[:, :2, :2]
    return float(np.einsum("ni,ni->n", e, np.linalg.solve(C, e[:, :, None])[:, :, 0]).mean() / 2)


def at_nodes(session: mm.Session, *paths: np.ndarray) -> tuple[np.ndarray, Rotation]:
    """True places of all nodes of logs whose true paths are given, and what takes odometry's axes there to true."""
    places, turned = [], []
    for log, path, one in zip(session.given, paths, session.paths, strict=True):
        places.append(path[one.middles])
        turned.append((log.orientations[one.middles] * upright(heading_along(path))[one.middles].inv()).inv())
    return np.concatenate(places), Rotation.concatenate(turned)


def ceiling(session: mm.Session, p: np.ndarray, turned: Rotation) -> mm.Survey:
    """The trajectory with the true relative pose at every revisit, to a centimetre."""
    one, graph = session.paths[0], session.graph
    near = one.windows[0].config.window_length * one.windows[0].length / 2
    graph.closures = [
        Closure(a, b, true_shift(a, b, p, turned), 1e-4 * np.eye(6), 12.0)
        for b in range(len(p))
        for a in range(b - APART + 1)
        if np.linalg.norm(p[a] - p[b]) < near
    ]
    solve(graph)
    return corrected(one, graph)


def true_shift(a: int, b: int, p: np.ndarray, turned: Rotation) -> RigidTransform:
    """Node b in the axes that odometry had at node a."""
    back = turned[a].inv()
    return RigidTransform.from_components(back.apply(p[b] - p[a]), back * turned[b])


def off_truth(session: mm.Session, p: np.ndarray, turned: Rotation) -> list[float]:
    """How far off each closure is in the plane, m."""
    closures = session.graph.closures
    shifts = [c.T_first_second.translation - true_shift(c.first, c.second, p, turned).translation for c in closures]
    return [float(np.linalg.norm(shift[:2])) for shift in shifts]


def survivors(session: mm.Session, off: list[float]) -> tuple[int, int]:
    """How many closures are wrong, and how many of those the graph keeps."""
    half = session.paths[0].windows[0].length / 2
    wrong = [
        closure
        for apart, closure in zip(off, session.graph.closures, strict=True)
        if apart > max(half, 3 * float(np.sqrt(np.trace(closure.covariance[3:5, 3:5]))))
    ]
    return len(wrong), sum(bool(closure.is_kept) for closure in wrong)


def work(name: str) -> dict[str, object]:
    kind, passes, percent, seed = name.split(" ")
    rng = np.random.default_rng([PLACES.index(kind), int(seed)])
    path, field = place(kind, int(passes), rng)
    log = drifted(path, field, float(percent), rng)
    session, seconds, processor = timed(mm.slam, log)
    field_length, ahead = session.paths[0].windows[0].length, upright(heading_along(path))
    p, turned = at_nodes(session, path)
    off = off_truth(session, p, turned)
    wrong, survive = survivors(session, off)
    after, nees = session.trajectories[0], nees_of(session, p, turned)
    return {
        "name": name, "length": float(path_walked(path)[-1]), "field_length": field_length,
        "before": aligned_rms(log.positions[:, :2], path[:, :2]),
        "after": aligned_rms(after.positions[:, :2], path[:, :2]),
        "but_scale": aligned_rms(after.positions[:, :2], path[:, :2], is_scaled=True),
        "heading": [heading_error(log, ahead), heading_error(after, ahead)], "nees": nees,
        "ceiling": aligned_rms(ceiling(session, p, turned).positions[:, :2], path[:, :2]),
        "closures": len(off), "off": off, "wrong": wrong, "survive": survive, "seconds": seconds,
        "processor": processor,
    }  # fmt: skip


def main() -> None:
    asked = arguments(
        __doc__, out=Path, first=100, seeds=20, places=list(PLACES), passes=list(PASSES), drifts=list(DRIFTS),
        jobs=os.cpu_count(), minutes=np.inf, save=saver,
    )  # fmt: skip
    seeds = range(asked.first, asked.first + asked.seeds)
    groups = [
        f"{kind} {passes} {percent}" for kind in asked.places for passes in asked.passes for percent in asked.drifts
    ]
    # Short logs first: a run that ends early has some of each place.
    order = sorted(groups, key=lambda group: int(group.split()[1]))
    wanted = [f"{group} {seed}" for seed in seeds for group in order]
    rows = kept(asked.out / "scenarios.jsonl", wanted, work, jobs=asked.jobs, minutes=asked.minutes)
    table = []
    for group, some in in_groups(groups, rows):
        before, after = (np.array([r[key] for r in some]) for key in ("before", "after"))
        heading = np.array([r["heading"] for r in some])
        total = {key: sum(r[key] for r in some) for key in ("closures", "wrong", "survive", "seconds", "length")}
        table.append([
            *group.split(" "), len(some), f"{np.median(before):.3f}", f"{np.median(after):.3f}",
            f"{np.median(after / before):.2f}", f"{(after / before).max():.2f}",
            f"{np.median([r['but_scale'] / r['before'] for r in some]):.2f}",
            f"{np.median([r['ceiling'] / r['before'] for r in some]):.2f}",
            f"{np.median(heading[:, 1] / heading[:, 0]):.2f}", f"{np.median([r['nees'] for r in some]):.2f}",
            total["closures"], total["wrong"], total["survive"], f"{total['seconds'] / total['length']:.3f}",
        ])  # fmt: skip
    show(COLUMNS, table, asked.save, rows.values())


if __name__ == "__main__":
    main()
