# SPDX-License-Identifier: BSD-3-Clause
"""Phones in a mall: a fifth of a floor's walks is looked for in the map of the others, and in those of other floors.

    python benchmarks/experiments/phones/held_out_walks.py --data DIR --out DIR [--floors F3 F4] [--walks 40]
        [--jobs 2] [--save NAME]

DIR holds a folder of XYZ10's logs for each floor (`magmatch datasets list` names the source). Of each floor some
walks, evenly chosen among all, are taken. Slam corrects and maps four fifths with their surveyed points; the rest are
held out, and found without theirs. *Asked* are their points within 1 m of a mapped path, after 30 m walked. Errors
are distances from point to pose; walkers' marks are metres off themselves (points_against_field.py). Wrong: over 5 m
and three standard deviations. *Elsewhere*: held-out walks of which another floor's map states a pose. Maps stay in
``--out``.
"""

import logging
import os
from functools import cache, partial
from pathlib import Path
from typing import Any

import numpy as np
from scipy.spatial import cKDTree

import magmatch as mm
from magmatch.geometry import path_walked
from magmatch.phones import open_walk
from magmatch_evaluation.saved_table import saver, show
from magmatch_evaluation.script import arguments, kept

COLUMNS = (
    "floor", "mapped walks", "mapped, m", "held out", "with a pose", "points asked", "with a pose there", "median, m",
    "90 %, m", "wrong", "looked for elsewhere", "with a pose elsewhere",
)  # fmt: skip
EVERY, NEAR, LEAST_WALKED = 5, 1.0, 30.0  # m
WRONG_M, WRONG_SDS = 5.0, 3.0


def walks_of(folder: Path, n: int) -> list[Path]:
    """Some logs of a floor, evenly chosen among all."""
    logs = sorted(folder.glob("*.txt*"))
    return [logs[int(k)] for k in np.linspace(0, len(logs), min(n, len(logs)), endpoint=False)]


def divided(logs: list[Path]) -> tuple[list[Path], list[Path]]:
    """The logs of the map, and those held out."""
    held_out = logs[EVERY // 2 :: EVERY]
    return [log for log in logs if log not in held_out], held_out


def make_map(logs: list[Path], path: Path) -> None:
    """Map some walks, once: of the largest frame, if they do not all meet."""
    if not path.exists():
        session = mm.slam([open_walk(log).survey() for log in logs])
        sizes = [sum(len(session.trajectories[k]) for k in logs_of) for logs_of in session.components]
        session.map(int(np.argmax(sizes))).save(path)


@cache
def load(path: Path) -> mm.FieldMap:
    """Load a map; a process keeps those of all floors."""
    return mm.FieldMap.load(path)


def one(data: Path, out: Path, name: str) -> dict[str, Any]:
    """Look for a held-out walk; name is ``FLOOR OF_MAP LOG``."""
    logging.getLogger("magmatch").setLevel(logging.ERROR)
    floor, floor_of_map, log = name.split(" ")
    field_map, walk = load(out / f"{floor_of_map}.map"), open_walk(data / floor / log).survey()
    track = mm.localize(field_map, walk)
    row: dict[str, Any] = {"is_stated": bool(track.is_stated.any()), "points": [], "mapped": len(field_map.surveys)}
    row["metres"] = float(sum(path_walked(part.positions)[-1] for part in field_map.surveys))
    if floor != floor_of_map or walk.waypoints is None:
        return row
    walked, paths = path_walked(walk.positions), cKDTree(field_map.survey.positions[:, :2])
    for t, place in zip(walk.waypoints.times, walk.waypoints.places, strict=True):
        k = int(np.argmin(np.abs(walk.times - t)))
        if walked[k] < LEAST_WALKED or paths.query(place)[0] > NEAR:
            continue
        estimate, found = track.estimates[k], None
        if estimate.is_stated:
            sd = float(np.sqrt(np.linalg.eigvalsh(estimate.covariance[3:, 3:])[-1]))
            found = [float(np.linalg.norm(estimate.T_map_body.translation[:2] - place)), sd]
        row["points"].append(found)
    return row


def line(floor: str, rows: dict[str, dict[str, Any]]) -> list[str]:
    """One row of the table."""
    own = [row for name, row in rows.items() if name.startswith(f"{floor} {floor} ")]
    others = [row for name, row in rows.items() if name.split(" ")[0] == floor != name.split(" ")[1]]
    points = [found for row in own for found in row["points"]]
    stated = np.array([found for found in points if found is not None]).reshape(-1, 2)
    off = [f"{np.quantile(stated[:, 0], q):.1f}" if len(stated) else "" for q in (0.5, 0.9)]
    wrong = (stated[:, 0] > WRONG_M) & (stated[:, 0] > WRONG_SDS * stated[:, 1])
    return [
        floor, str(own[0]["mapped"]), f"{own[0]['metres']:.0f}", str(len(own)), str(sum(r["is_stated"] for r in own)),
        str(len(points)), str(len(stated)), *off, str(int(wrong.sum())), str(len(others)),
        str(sum(r["is_stated"] for r in others)),
    ]  # fmt: skip


def main() -> None:
    asked = arguments(
        __doc__, data=Path, out=Path, floors=["F3", "F4"], walks=1000, jobs=os.cpu_count(), minutes=np.inf, save=saver
    )
    asked.out.mkdir(parents=True, exist_ok=True)
    logging.getLogger("magmatch").setLevel(logging.ERROR)
    logs = {floor: walks_of(asked.data / floor, asked.walks) for floor in asked.floors}
    for floor, some in logs.items():
        make_map(divided(some)[0], asked.out / f"{floor}.map")
    names = [
        f"{floor} {other} {log.name}" for floor, some in logs.items() for log in divided(some)[1] for other in logs
    ]
    work = partial(one, asked.data, asked.out)
    rows = kept(asked.out / "rows.jsonl", names, work, jobs=asked.jobs, minutes=asked.minutes)
    show(COLUMNS, [line(floor, rows) for floor in asked.floors], asked.save, rows.values())


if __name__ == "__main__":
    main()
