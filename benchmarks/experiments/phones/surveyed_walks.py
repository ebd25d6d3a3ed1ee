# SPDX-License-Identifier: BSD-3-Clause
"""Phones' walks of one floor with surveyed points: dead reckoning, and slam at points that it is not told.

    python benchmarks/experiments/phones/surveyed_walks.py --data DIR [--floor F2] [--walks 10] [--save NAME]

DIR holds a folder of XYZ10's logs for each floor (`magmatch datasets list` names the source). Taken are the walks
that pass most often near each other, by their surveyed points. *Odometry*: rms distance of dead reckoning to all
points of a walk after one rigid alignment, and its length over that of the line through the points. Then slam of all
walks together, every third point left out (never the first or last of a walk), with the error there: of slam; of slam
less what the kept points of the walk are off by in the mean (points of walks contradict each other by metres along
the path where their fields agree, see points_against_field.py, so the former says how far walkers were mistaken,
too); of the same graph without the field's closures; of dead reckoning bent to the points that are kept (turned,
scaled and shifted between each two of them); of the straight line between these. *Field*: norm and vertical component
within 0.7 m of another walk, from that, where slam has the walks and where the same graph does without closures: the
points do not judge this.
"""

import logging
import tempfile
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from scipy.spatial import cKDTree

import magmatch as mm
from magmatch.data.formats.format import SurveyFormat
from magmatch.data.formats.phones.read import read_phone_log
from magmatch.data.surveyed_points import SurveyedPoints
from magmatch.preparation.odometry.dead_reckon import dead_reckon
from magmatch.slam.graph.anchors import Anchor, waypoints
from magmatch.slam.graph.solve import solve
from magmatch.slam.graph.trajectories import corrected
from magmatch_evaluation.saved_table import saver, show
from magmatch_evaluation.script import arguments, timed

COLUMNS = (
    "walk", "points", "left out", "m", "odometry, m", "length, ratio", "slam, m", "less own, m", "without field, m",
    "bent odometry, m", "line, m", "closures",
)  # fmt: skip
BESIDE, EVERY = 0.7, 5  # m between samples that pass one place, of each fifth
NEAR, LEAST = 2.0, 4  # m between walks that pass one place; points of a walk from which some can be left out


def points_of_walks(folder: Path) -> dict[Path, SurveyedPoints]:
    """The surveyed points of each log that holds any."""
    found = (
        (path, read_phone_log(path, ("field",), with_points=True).points) for path in sorted(folder.glob("*.txt*"))
    )
    return {path: points for path, points in found if points is not None}


def line_through(points: SurveyedPoints) -> np.ndarray:
    """Places every half metre on the line through a walk's points, (n, 2)."""
    places = points.places[np.argsort(points.times)]
    far = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(places, axis=0), axis=1))])
    return np.column_stack([np.interp(np.arange(0, far[-1], 0.5), far, axis) for axis in places.T])


def chosen(points: dict[Path, SurveyedPoints], n: int) -> list[Path]:
    """The walks that pass most often near each other, one by one: the next is on most of the path so far."""
    lines = {path: line_through(some) for path, some in points.items() if len(some.times) >= LEAST}
    shared = {
        (a, b): float((np.linalg.norm(p[:, None] - q, axis=2).min(axis=1) < NEAR).sum())
        for a, p in lines.items()
        for b, q in lines.items()
        if a != b
    }
    taken = list(max(shared, key=lambda pair: (shared[pair], str(pair))))[:n]
    while len(taken) < min(n, len(lines)):
        rest = [a for a in lines if a not in taken]
        taken.append(max(rest, key=lambda a: (sum(shared[a, b] for b in taken), str(a))))
    return sorted(taken)


def aligned(path: np.ndarray, places: np.ndarray) -> float:
    """Rms distance after the best turn and shift in the plane, m."""
    p, q = (np.array([1, 1j]) @ (v - v.mean(axis=0)).T for v in (path, places))
    turn = np.exp(1j * np.angle(np.vdot(p, q)))
    return float(np.sqrt((np.abs(turn * p - q) ** 2).mean()))


def bent(walk: np.ndarray, places: np.ndarray, kept: np.ndarray) -> np.ndarray:
    """Odometry's positions at the points as places, where those that are kept have to be: (n, 2)."""
    p, q = (np.array([1, 1j]) @ v.T for v in (walk, places))
    found = q.copy()
    for k in np.flatnonzero(~kept):
        a, b = np.flatnonzero(kept[:k])[-1], k + np.flatnonzero(kept[k:])[0]
        share = (p[k] - p[a]) / (p[b] - p[a])
        found[k] = q[a] + share * (q[b] - q[a])
    return np.column_stack([found.real, found.imag])


def at(times: np.ndarray, survey: mm.Survey) -> np.ndarray:
    """Positions in the plane at some times, (n, 2)."""
    return np.column_stack([np.interp(times, survey.times, axis) for axis in survey.positions.T[:2]])


def field_beside(walks: list[mm.Survey], positions: list[np.ndarray]) -> float:
    """Robust standard deviation of the field from that of the nearest sample of other walks, uT."""
    b = [1e6 * np.column_stack([np.linalg.norm(w.field, axis=1), w.field[:, 2]])[::EVERY] for w in walks]
    x, off = [p[::EVERY, :2] for p in positions], []
    for k in range(len(walks)):
        others, values = (np.concatenate(v[:k] + v[k + 1 :]) for v in (x, b))
        far, at = cKDTree(others).query(x[k])
        off.append((b[k] - values[at])[far < BESIDE])
    return float(1.4826 * np.median(np.abs(np.concatenate(off))))


def rms(off: np.ndarray) -> float:
    """Of vectors, m."""
    return float(np.sqrt((off**2).sum(axis=1).mean())) if len(off) else np.nan


@dataclass(frozen=True, eq=False)
class Walk:
    """A walk by dead reckoning, and its surveyed points in the order of their times."""

    survey: mm.Survey
    times: np.ndarray  # (n,), s
    places: np.ndarray  # (n, 2), m
    kept: np.ndarray  # (n,): which slam is told
    anchors: list[Anchor]

    @classmethod
    def of(cls, path: Path, points: SurveyedPoints) -> "Walk":
        """Dead reckon a walk, and leave out every third point of it."""
        with tempfile.TemporaryDirectory() as folder:
            poses = Path(folder) / "walk.tum"
            dead_reckon(read_phone_log(path)).trajectory.save(poses)
            survey = mm.read_survey(path, SurveyFormat(trajectory=poses))
        order = np.argsort(points.times, kind="stable")
        kept = np.arange(len(order)) % 3 != 1
        kept[-1] = True
        told = set(points.times[order[kept]].tolist())
        anchors = [a for a in waypoints(points, survey, path.name) if a.t in told]
        return cls(survey, points.times[order], points.places[order], kept, anchors)

    @property
    def length(self) -> float:
        """Of the line through the points, m."""
        return float(np.linalg.norm(np.diff(self.places, axis=0), axis=1).sum())

    def errors(self, *others: mm.Survey) -> list[np.ndarray]:
        """At the points left out, of corrected surveys, bent odometry and the line: (n, 2) each."""
        line = [np.interp(self.times, self.times[self.kept], axis) for axis in self.places[self.kept].T]
        odometry = bent(at(self.times, self.survey), self.places, self.kept)
        found = [*(at(self.times, other) for other in others), odometry, np.column_stack(line)]
        return [(v - self.places)[~self.kept] for v in found]

    def as_marked(self, other: mm.Survey) -> mm.Survey:
        """A corrected survey, moved by what the kept points are off by in the mean."""
        off = (self.places - at(self.times, other))[self.kept].mean(axis=0)
        return replace(other, positions=other.positions + np.append(off, 0.0))


def main() -> None:
    asked = arguments(__doc__, data=Path("../shared/data/xyz10"), floor="F2", walks=10, save=saver)
    logging.getLogger("magmatch").setLevel(logging.ERROR)
    points = points_of_walks(asked.data / asked.floor)
    paths = chosen(points, asked.walks)
    walks = [Walk.of(path, points[path]) for path in paths]
    told, surveys = [a for w in walks for a in w.anchors], [w.survey for w in walks]
    session = timed(lambda: mm.slam(surveys, anchors=told, waypoints=False))
    logs, trajectories = session.value.result().logs, session.value.trajectories
    alone = session.value.graph.copied()
    alone.closures, alone.submap_factors = [], ()
    solve(alone)
    without = [corrected(path, alone) for path in session.value.paths]
    rows, errors = [], []
    for walk, log, there, other in zip(walks, logs, trajectories, without, strict=True):
        errors.append(walk.errors(there, walk.as_marked(there), other))
        rows.append(
            [log.name.partition(".")[0][-8:], len(walk.kept), int((~walk.kept).sum()), f"{walk.length:.0f}",
             f"{aligned(at(walk.times, walk.survey), walk.places):.2f}", f"{log.length / walk.length:.2f}",
             *(f"{rms(v):.2f}" for v in errors[-1]), log.n_closures]
        )  # fmt: skip
    sums = [sum(int(row[k]) for row in rows) for k in (1, 2, 3)]
    medians = [f"{np.median([float(row[k]) for row in rows]):.2f}" for k in (4, 5)]
    together = [f"{rms(np.concatenate(column)):.2f}" for column in zip(*errors, strict=True)]
    n_kept = sum(c.is_kept for c in session.value.graph.closures)
    rows.append(["all (of odometry: median)", *sums, *medians, *together, n_kept])
    show(COLUMNS, rows, asked.save)
    beside = [field_beside(surveys, [one.positions for one in some]) for some in (trajectories, without)]
    print("field beside other walks: {:.2f} uT; without closures {:.2f}".format(*beside))
    print(f"slam: {session.processor:.0f} s of the processor")


if __name__ == "__main__":
    main()
