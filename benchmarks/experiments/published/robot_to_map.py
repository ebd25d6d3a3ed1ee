# SPDX-License-Identifier: BSD-3-Clause
"""Readings of the published method under which its robot is found in its map, and oracles that say why others fail.

    python benchmarks/experiments/published/robot_to_map.py [--quick] [--tables 6] [--first-seed 31000000]
        [--minutes 600] [--rows FILE] [--save NAME]

Each table of magnets is simulated from its own seed (scenario table-robot) and mapped at three heights, or at the
robot's height alone, in rows along and across; "middle" keeps samples within 0.72 m of the table's middle, about
which the robot circles: there the inducing points allowed follow the field. X* of a map is its region, or one layer
at the robot's height. "det H > 0" stands in place of det H above its mean. An oracle has the true field at X* of
both. Right: accepted within 0.10 m and 5 deg. Of the robot's keypoints: how many have one of the map within a
spacing, and how far those x-axes are apart; of the matches: how many are within two spacings of the truth. Rows that
FILE holds are not made again.
"""

from collections.abc import Callable
from dataclasses import replace
from functools import partial
from pathlib import Path

import numpy as np
from scipy.spatial import cKDTree
from scipy.spatial.transform import RigidTransform

import magmatch as mm
from magmatch import published
from magmatch.features.extract import features_of
from magmatch.features.keypoints import curvature_response
from magmatch.field.values import FieldValues
from magmatch.geometry import rotate_vectors, transform_error, transform_points
from magmatch.grid import RegularGrid
from magmatch.published import Inferred, PublishedConfig
from magmatch.published.register import comparable
from magmatch.simulation.paths import SensorPath, boustrophedon
from magmatch.simulation.scenarios import ROBOT_HEIGHT, TABLE_ROW_SPACING, TABLE_SIZE, build_scene
from magmatch.simulation.scene import Scene, SimulatedPair, Streams
from magmatch.simulation.simulate import measure
from magmatch_evaluation.experiments import Tolerance
from magmatch_evaluation.saved_table import saver, show
from magmatch_evaluation.script import arguments, in_groups, kept

COLUMNS = (
    "reading", "tables", "right", "wrong", "refused", "no pose", "keypoints near one of the map",
    "x-axes apart, deg", "matches right",
)  # fmt: skip
# Survey of the map, X* of the map, threshold of det H, whether the field at X* is the true one.
READINGS = {
    "three-heights, region, mean": ("three", "region", "mean", False),
    "three-heights, region, mean, oracle": ("three", "region", "mean", True),
    "three-heights, layer, mean": ("three", "layer", "mean", False),
    "three-heights, layer, det H > 0": ("three", "layer", "positive", False),
    "one-height, layer, mean": ("one", "layer", "mean", False),
    "one-height, layer, det H > 0": ("one", "layer", "positive", False),
    "one-height, layer, det H > 0, oracle": ("one", "layer", "positive", True),
    "one-height, middle, layer, mean": ("middle", "layer", "mean", False),
    "one-height, middle, layer, det H > 0": ("middle", "layer", "positive", False),
}
MIDDLE = 0.72  # m
STEP = 2e-3  # m, of the differences that give the true derivatives


def of_one_table(name: str) -> dict[str, object]:
    """Try all readings on one table; ``name`` holds its seed."""
    seed = int(name.rsplit(maxsplit=1)[-1])
    pair = mm.simulate("table-robot", seed)
    scene, robot = build_scene("table-robot", pair.config, Streams(seed)), mm.build_map(pair.target, published.FIELD)
    one = at_one_height(scene, pair, Streams(seed).base_errors)
    in_middle = one.subset(np.all(np.abs(one.positions[:, :2]) < MIDDLE, axis=1))
    surveys = {"three": pair.base, "one": one, "middle": in_middle}
    maps = {which: mm.build_map(survey, published.FIELD) for which, survey in surveys.items()}
    return {
        reading: tried(maps[which], robot, scene, where, threshold, is_true=is_true)
        for reading, (which, where, threshold, is_true) in READINGS.items()
    }


def at_one_height(scene: Scene, pair: SimulatedPair, rng: np.random.Generator) -> mm.Survey:
    """Sweep the table along and across at the robot's height."""
    high, heights = np.array([*TABLE_SIZE, 0.0]) / 2, (ROBOT_HEIGHT,)
    sweeps = [boustrophedon(-high, high, heights, TABLE_ROW_SPACING, along, 1250) for along in (0, 1)]
    config = pair.config.model_copy(update={"pose_drift": 0.0})
    return measure(SensorPath(np.concatenate(sweeps)), scene.base_sources, scene.earth_field, config, rng)


def tried(
    base: mm.FieldMap, robot: mm.FieldMap, scene: Scene, where: str, threshold: str, *, is_true: bool
) -> dict[str, object]:
    """Register by the published parts, one reading of them, and compare with the truth."""
    config, T = comparable(base, robot, PublishedConfig()), scene.T_base_target
    features = config.features
    at = [
        published.infer(base, features) if where == "region" else in_one_layer(base, features.spacing or 0.0),
        published.infer(robot, features),
    ]
    if is_true:
        frames_of = RigidTransform.identity(), T
        at = [replace(i, values=true_values(scene, M, i.positions)) for i, M in zip(at, frames_of, strict=True)]
    detect: Callable[[Inferred], np.ndarray] = partial(published.detect, config=features)
    if threshold == "positive":
        detect = lambda inferred: np.flatnonzero(curvature_response(inferred.values) > 0)  # noqa: E731
    frames = [published.local_frames(i, detect(i), features) for i in at]
    described = [published.describe(i, f, features.component_range) for i, f in zip(at, frames, strict=True)]
    found = [features_of(i, f, d) for i, f, d in zip(at, frames, described, strict=True)]
    matches = published.match(*described, config.matching)
    there = T.apply(found[1].positions)
    distance, near = cKDTree(found[0].positions).query(there)
    has, spacing = distance < at[0].spacing, at[0].spacing
    x_base, x_robot = frames[0].axes[near[has]][:, :, 0], T.rotation.apply(frames[1].axes[has][:, :, 0])
    apart = np.linalg.norm(found[0].positions[matches.base_rows] - there[matches.target_rows], axis=1)
    told = {
        "near": float(has.mean()), "matched": float(np.mean(apart < 2 * spacing)),
        "x_deg": float(np.degrees(np.median(np.arccos(np.clip((x_base * x_robot).sum(axis=1), -1, 1))))),
    }  # fmt: skip
    poses = published.consensus(*found, matches, spacing, config.consensus)
    if not poses:
        return told | {"outcome": "no pose"}
    error, angle = transform_error(poses[0].T_base_target, T, robot.survey.centroid)
    is_near = error <= Tolerance().distance and np.degrees(angle) <= Tolerance().angle_deg
    is_accepted = published.fitness(base, robot.survey, poses[0].T_base_target).passes(config.decision)
    return told | {"outcome": ("right" if is_near else "wrong") if is_accepted else "refused"}


def in_one_layer(base: mm.FieldMap, spacing: float) -> Inferred:
    """X* of the map in one layer at the robot's height, which its sensor shares."""
    p = base.survey.positions.copy()
    p[:, 2] = ROBOT_HEIGHT
    grid = RegularGrid.over(p, spacing)
    cells = np.flatnonzero(base.knows(grid.points()))
    positions = grid.points()[cells]
    return Inferred(base, grid, cells, positions, base.evaluate(positions, 2))


def true_values(scene: Scene, T_base_map: RigidTransform, points: np.ndarray) -> FieldValues:
    """True field at points of a map, its derivatives by central differences."""

    def field(offset: np.ndarray) -> np.ndarray:
        truth = scene.base_field(transform_points(points + STEP * offset, T_base_map))
        return rotate_vectors(truth, T_base_map.inv())

    e, here = np.eye(3), field(np.zeros(3))
    ahead, back = ([field(way * e[i]) for i in range(3)] for way in (1, -1))
    gradient = np.stack([(ahead[i] - back[i]) / (2 * STEP) for i in range(3)], axis=2)
    second = np.empty((len(points), 3, 3, 3))
    for i in range(3):
        second[:, :, i, i] = (ahead[i] - 2 * here + back[i]) / STEP**2
        for j in range(i):
            mixed = field(e[i] + e[j]) - field(e[i] - e[j]) - field(e[j] - e[i]) + field(-e[i] - e[j])
            second[:, :, i, j] = second[:, :, j, i] = mixed / (4 * STEP**2)
    return FieldValues(here, gradient, second)


def main() -> None:
    """Make the rows that are lacking, and print what they say together."""
    asked = arguments(
        __doc__, quick=False, tables=6, first_seed=31_000_000, minutes=600.0, rows=Path("robot_to_map.jsonl"),
        save=saver,
    )  # fmt: skip
    names = [f"table {asked.first_seed + k}" for k in range(1 if asked.quick else asked.tables)]
    made = kept(asked.rows, names, of_one_table, minutes=asked.minutes)
    rows = []
    for reading in READINGS:
        some = [row[reading] for _, all_of in in_groups(["table"], made) for row in all_of]
        outcomes = [row["outcome"] for row in some]
        counts = [outcomes.count(what) for what in ("right", "wrong", "refused", "no pose")]
        near, matched = (f"{np.mean([row[key] for row in some]):.0%}" for key in ("near", "matched"))
        x_deg = f"{np.nanmedian([row['x_deg'] for row in some]):.0f}"
        rows.append([reading, len(some), *counts, near, x_deg, matched])
    show(COLUMNS, rows, asked.save, made.values())


if __name__ == "__main__":
    main()
