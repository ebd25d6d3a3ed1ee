# SPDX-License-Identifier: BSD-3-Clause
"""Dead reckoning of real walks with phones, against surveyed points and the odometry that the recordings came with.

    python benchmarks/experiments/phones/phone_odometry.py [--from DIR] [--save NAME]

The 20 training logs of IPIN 2023, track 3 (GetSensorData; DIR holds ``ipin2023/`` and ``walks_baselines.json``): 5
routes of a museum, 59 to 112 m between surveyed points, two walks with each of two phones. Absolute trajectory error:
rms distance to the points (10 to 16 a walk) after one rigid alignment of the path to them. Settings were chosen on
routes 1 to 3; routes 4 and 5 were looked at with what was chosen. Ends with 1 where a median is worse than the
baseline's.
"""

import json
import re
import sys
from pathlib import Path

import numpy as np
from scipy.spatial.transform import Rotation

from magmatch.data.formats.phones.read import read_phone_log
from magmatch.data.tables.text import read_bytes
from magmatch.preparation.odometry.dead_reckon import dead_reckon
from magmatch_evaluation.saved_table import saver, show
from magmatch_evaluation.script import arguments, timed

COLUMNS = ("walk", "points", "steps", "ATE, m", "baseline, m", "best scale", "s")
EARTH_RADIUS = 6_371_000.0  # m; the site is 50 m wide
PARTS = {"routes 1 to 3 (chosen on)": "123", "routes 4 and 5 (held out)": "45", "all": "12345"}


def surveyed_points(path: Path) -> np.ndarray:
    """Times (s, app's clock) and positions (m, in a local plane) of the POSI rows: (n, 3)."""
    rows = re.findall(rb"(?m)^POSI;([\d.]+);\d+;([-\d.]+);([-\d.]+);", read_bytes(path))
    times, latitude, longitude = np.array(rows, dtype=np.float64).T
    north, east = (np.radians(v - v[0]) * EARTH_RADIUS for v in (latitude, longitude))
    return np.column_stack([times, east * np.cos(np.radians(latitude[0])), north])


def trajectory_error(path: np.ndarray, points: np.ndarray) -> tuple[float, float]:
    """Error (rms, m) after the best turn and shift, and the scale that would fit best."""
    p, q = (np.column_stack([v - v.mean(axis=0), np.zeros(len(v))]) for v in (path, points))
    matched = Rotation.align_vectors(q, p)[0].apply(p) if np.ptp(p) > 0 else p
    return float(np.sqrt(((matched - q) ** 2).sum(axis=1).mean())), float((matched * q).sum() / (p**2).sum())


def main() -> None:
    asked = arguments(__doc__, recordings=None, save=saver)
    baselines = json.loads((asked.recordings / "walks_baselines.json").read_text())["odometry"]
    rows, errors = [], {}
    for path in sorted((asked.recordings / "ipin2023").glob("*.txt.gz")):
        route, repetition = re.findall(r"Trial0(\d)_repetition0(\d)", path.name)[0]
        walk = timed(lambda path=path: dead_reckon(read_phone_log(path)))
        points = surveyed_points(path)
        positions, _ = walk.value.trajectory.interpolate(points[:, 0])
        error, scale = trajectory_error(positions[:, :2], points[:, 1:])
        baseline = baselines[f"ipin2023/route{route}_{repetition}"]["rmse_m"]
        errors[path] = (route, error, baseline)
        rows.append(
            [f"route {route}, {repetition}", len(points), len(walk.value.steps), f"{error:.2f}", f"{baseline:.2f}",
             f"{scale:.2f}", f"{walk.clock:.1f}"]
        )  # fmt: skip
    is_worse = False
    for words, routes in PARTS.items():
        ours, theirs = np.median([values for route, *values in errors.values() if route in routes], axis=0)
        rows.append([f"median, {words}", "", "", f"{ours:.2f}", f"{theirs:.2f}", "", ""])
        is_worse |= bool(ours > theirs)
    show(COLUMNS, rows, asked.save)
    sys.exit(int(is_worse))


if __name__ == "__main__":
    main()
