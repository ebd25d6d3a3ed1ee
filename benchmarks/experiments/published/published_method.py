# SPDX-License-Identifier: BSD-3-Clause
"""The published method in rooms it has never seen, and what it knows where it looks.

    python benchmarks/experiments/published/published_method.py [--quick] [--rooms 20] [--first-seed 31000000]
        [--scenarios office-random] [--presets paper] [--minutes 600] [--rows FILE] [--save NAME]

Each room is simulated from its own seed, registered, and compared with the truth: right = accepted within 0.10 m and
5 deg. Of both maps: the share of X* and of the keypoints outside the convex hull of the samples. Of the base: how
many 95 % intervals of a field component hold the true one at its keypoints. Rows that FILE holds are not made again.
"""

from pathlib import Path

import numpy as np
from scipy.spatial import Delaunay

import magmatch as mm
from magmatch.published import detect, infer
from magmatch.simulation.scenarios import build_scene
from magmatch.simulation.scene import Streams
from magmatch_evaluation.experiments import Tolerance
from magmatch_evaluation.saved_table import saver, show
from magmatch_evaluation.script import arguments, in_groups, kept, pose_error, timed

COLUMNS = (
    "scenario, preset", "rooms", "right", "wrong", "refused", "no pose", "median error, mm / deg",
    "X* outside the hull", "keypoints outside the hull", "95 % intervals that hold, keypoints",
    "median s, processor",
)  # fmt: skip


def in_one_room(name: str) -> dict[str, object]:
    """Register one room; ``name`` holds scenario, preset and seed."""
    scenario, preset, seed = name.split()
    pair, config = mm.simulate(scenario, int(seed)), mm.PRESETS[preset]
    maps = [mm.build_map(one, config.field) for one in (pair.base, pair.target)]
    result, _, seconds = timed(mm.register, *maps, config)
    distance, angle = pose_error(result, pair.T_base_target, pair.target.centroid)
    tolerance = Tolerance()
    is_near = distance <= tolerance.distance and np.degrees(angle) <= tolerance.angle_deg
    if result.best_pose is None:
        outcome = "no pose"
    else:
        outcome = ("right" if is_near and pair.accept else "wrong") if result.is_accepted else "refused"
    told = {"outcome": outcome, "mm": 1e3 * distance, "deg": float(np.degrees(angle)), "seconds": seconds}
    base, target = (what_it_knows(one, config.keypoints.features) for one in maps)
    scene = build_scene(scenario, pair.config, Streams(int(seed)))
    told |= {key: (base[key] + target[key]) / 2 for key in ("points_outside", "keypoints_outside")}
    return told | {"held": share_held(maps[0], base["keypoints"], scene.base_field)}


def what_it_knows(field_map: mm.FieldMap, config: object) -> dict[str, object]:
    """X* and the keypoints of one map: which lie outside the samples' hull, and where the keypoints are."""
    inferred = infer(field_map, config)
    hull, keypoints = Delaunay(field_map.survey.positions), inferred.positions[detect(inferred, config)]
    outside = [float(np.mean(hull.find_simplex(p, tol=1e-6) < 0)) for p in (inferred.positions, keypoints)]
    return {"points_outside": outside[0], "keypoints_outside": outside[1], "keypoints": keypoints}


def share_held(field_map: mm.FieldMap, points: np.ndarray, truth: object) -> float:
    """Share of the components of the true field within 1.96 standard deviations of the map's."""
    sd = np.sqrt(np.diagonal(field_map.covariance(points), axis1=1, axis2=2))
    return float(np.mean(np.abs(field_map.evaluate(points).field - truth(points)) < 1.96 * sd))


def main() -> None:
    """Make the rows that are lacking, and print what they say together."""
    asked = arguments(
        __doc__, quick=False, rooms=20, first_seed=31_000_000, scenarios=["office-random"], presets=["paper"],
        minutes=600.0, rows=Path("published_rooms.jsonl"), save=saver,
    )  # fmt: skip
    groups = [f"{scenario} {preset}" for scenario in asked.scenarios for preset in asked.presets]
    seeds = range(asked.first_seed, asked.first_seed + (2 if asked.quick else asked.rooms))
    # Seed by seed, so that a run cut short compares the presets in the same rooms.
    names = [f"{group} {seed}" for seed in seeds for group in groups]
    made = kept(asked.rows, names, in_one_room, minutes=asked.minutes)
    rows = []
    for group, some in in_groups(groups, made):
        outcomes = [row["outcome"] for row in some]
        counts = [outcomes.count(what) for what in ("right", "wrong", "refused", "no pose")]
        errors = [f"{np.median([row[unit] for row in some]):.{digits}f}" for unit, digits in (("mm", 0), ("deg", 2))]
        shares = [
            f"{np.mean([row[key] for row in some]):.1%}" for key in ("points_outside", "keypoints_outside", "held")
        ]
        seconds = f"{np.median([row['seconds'] for row in some]):.1f}"
        rows.append([", ".join(group.split()), len(some), *counts, " / ".join(errors), *shares, seconds])
    show(COLUMNS, rows, asked.save, made.values())


if __name__ == "__main__":
    main()
