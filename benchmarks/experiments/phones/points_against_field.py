# SPDX-License-Identifier: BSD-3-Clause
"""Surveyed points of phones' walks against their field: it is the same where two walks passed one place.

    python benchmarks/experiments/phones/points_against_field.py --data DIR [--floor F2] [--save NAME]

DIR as for surveyed_walks.py. Dead reckoning is bent to all points of a walk. Straight stretches of 10 m are compared
with each other walk that passes within 2.5 m by its points: norm and vertical component, each less its mean, moved
along the path by up to 10 m. *Misfit*: rms difference over the stretch's own standard deviation. A stretch *matches*
where it is below 0.35 somewhere. Chance: with the same walks, moved another 20 to 60 m. *Triangles*: how far three
walks that match pairwise are from agreeing.
"""

import logging
from collections import defaultdict
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from surveyed_walks import Walk, at, points_of_walks

from magmatch_evaluation.saved_table import saver, show
from magmatch_evaluation.script import arguments

STEP, LENGTH, FARTHEST, BESIDE = 0.25, 10.0, 10.0, 2.5  # m
STRAIGHT, ALIKE, MATCHED = 0.9, 0.85, 0.35  # chord over length; cosine between directions; misfit
CALM = 1.5  # uT: a stretch whose field varies less tells nothing
LAGS = np.arange(-FARTHEST, FARTHEST + STEP / 2, STEP)
COLUMNS = ("", "compared", "match", "misfit at points", "at best", "moved, m", "over 2 m")


@dataclass(frozen=True, eq=False)
class Line:
    """A walk every quarter of a metre: places as complex numbers, directions, norm and vertical component (uT)."""

    places: np.ndarray
    directions: np.ndarray
    field: np.ndarray  # (n, 2)

    @classmethod
    def of(cls, walk: Walk) -> "Line | None":
        """None if it is no longer than a stretch."""
        rows = (walk.survey.times >= walk.times[0]) & (walk.survey.times <= walk.times[-1])
        times, field = walk.survey.times[rows], 1e6 * walk.survey.field[rows]
        if not len(times):
            return None
        places = through_points(walk, times)
        walked = np.append(0.0, np.cumsum(np.abs(np.diff(places))))
        even = np.arange(0.0, walked[-1], STEP)
        if len(even) * STEP <= LENGTH:
            return None
        values = np.column_stack([np.linalg.norm(field, axis=1), field[:, 2]])
        placed, told = (
            np.column_stack([np.interp(even, walked, v) for v in some])
            for some in ((places.real, places.imag), values.T)
        )
        z = placed @ [1, 1j]
        ahead = z[np.minimum(np.arange(len(z)) + 6, len(z) - 1)] - z[np.maximum(np.arange(len(z)) - 6, 0)]
        return cls(z, ahead / np.maximum(np.abs(ahead), 1e-9), told)


def through_points(walk: Walk, times: np.ndarray) -> np.ndarray:
    """Places by odometry that is turned, scaled and shifted between each two points, as complex numbers."""
    seen, marked, x = (v @ [1, 1j] for v in (at(walk.times, walk.survey), walk.places, at(times, walk.survey)))
    i = np.clip(np.searchsorted(walk.times, times) - 1, 0, len(marked) - 2)
    moved, share = seen[i + 1] - seen[i], (times - walk.times[i]) / (walk.times[i + 1] - walk.times[i])
    is_far = np.abs(moved) > 1.0
    share = np.where(is_far, (x - seen[i]) / np.where(is_far, moved, 1.0), share)
    return np.asarray(marked[i] + share * (marked[i + 1] - marked[i]))


@dataclass(frozen=True, eq=False, slots=True)
class Compared:
    """A stretch of a walk and another walk: misfit for each shift along the path."""

    pair: tuple[int, int]
    place: complex
    direction: complex
    misfits: np.ndarray

    @property
    def shift(self) -> float:
        """Of least misfit, m."""
        return float(LAGS[self.misfits.argmin()])


def compared(lines: list[Line], rng: np.random.Generator | None = None) -> list[Compared]:
    """All stretches with all walks beside them; with ``rng``, walks are moved far away first."""
    n, found = int(LENGTH / STEP), []
    for a, one in enumerate(lines):
        for start in range(0, len(one.places) - n + 1, n // 2):
            z, b = one.places[start : start + n], one.field[start : start + n]
            along = z[-1] - z[0]
            if abs(along) < STRAIGHT * LENGTH or b.std(axis=0).mean() < CALM:
                continue
            u, sd = along / abs(along), float(np.sqrt(b.var(axis=0).mean()))
            x, aside = ((z - z[0]) / u).real, ((z - z[0]) / u).imag.mean()
            for c, other in enumerate(lines):
                far = 0.0 if rng is None else rng.uniform(20, 60) * rng.choice([-1, 1])
                y = (other.places - z[0]) / u - far
                is_near = (np.abs(y.imag - aside) < BESIDE) & (np.abs((other.directions / u).real) > ALIKE)
                rows = np.flatnonzero(is_near & (y.real > -FARTHEST - 1) & (y.real < LENGTH + FARTHEST + 1))
                for run in np.split(rows, np.flatnonzero(np.diff(rows) > 1) + 1) if a != c and len(rows) else []:
                    if len(run) >= n and np.ptp(y.real[run]) >= LENGTH + 4:
                        misfits = misfit_by_shift(x, b, y.real[run], other.field[run]) / sd
                        if np.isfinite(misfits[np.abs(LAGS) <= 1]).any():
                            found.append(Compared((a, c), z.mean(), u, misfits))
    return found


def misfit_by_shift(x: np.ndarray, b: np.ndarray, y: np.ndarray, c: np.ndarray) -> np.ndarray:
    """Rms difference for each shift, uT; infinite where the other does not reach."""
    order, found = np.argsort(y), np.full(len(LAGS), np.inf)
    y, c = y[order], c[order]
    for k, shift in enumerate(LAGS):
        at_x = x + shift
        if at_x.min() > y[0] - STEP and at_x.max() < y[-1] + STEP:
            off = b - np.column_stack([np.interp(at_x, y, v) for v in c.T])
            found[k] = np.sqrt(((off - off.mean(axis=0)) ** 2).mean())
    return found


def triangles(matched: list[Compared]) -> np.ndarray:
    """Sums of shifts from a walk to a second, from there to a third, and back: m."""
    by_pair, sums = defaultdict(list), []
    for one in matched:
        by_pair[one.pair].append(one)
    for one in matched:
        for other in matched:
            if other.pair[0] != one.pair[0] or other.place != one.place or other.pair[1] == one.pair[1]:
                continue
            there = one.place + one.shift * one.direction
            some = [c for c in by_pair[one.pair[1], other.pair[1]] if abs(c.place - there) < LENGTH]
            if some:
                near = min(some, key=lambda c: abs(c.place - there))
                sign = np.sign((near.direction / one.direction).real)
                sums.append(one.shift + sign * near.shift - other.shift)
    return np.abs(sums)


def row(name: str, found: list[Compared]) -> list[object]:
    """Of a table."""
    best = [c for c in found if c.misfits.min() < MATCHED]
    if not best:
        return [name, len(found), 0, "", "", "", ""]
    marked = [c.misfits[np.abs(LAGS) <= 0.5].min() for c in best]
    moved = np.array([abs(c.shift) for c in best])
    medians = (np.median(v) for v in (marked, [c.misfits.min() for c in best], moved))
    return [name, len(found), len(best), *(f"{v:.2f}" for v in medians), f"{(moved > 2).mean():.2f}"]


def main() -> None:
    asked = arguments(__doc__, data=Path("../shared/data/xyz10"), floor="F2", save=saver)
    logging.getLogger("magmatch").setLevel(logging.ERROR)
    points = points_of_walks(asked.data / asked.floor)
    walks = [Walk.of(path, some) for path, some in points.items() if len(some.times) > 1]
    lines = [line for line in map(Line.of, walks) if line is not None]
    found, chance = compared(lines), compared(lines, np.random.default_rng(0))
    show(COLUMNS, [row("beside by their points", found), row("by chance", chance)], asked.save)
    off = triangles([c for c in found if c.misfits.min() < MATCHED])
    if len(off):
        print(f"triangles: {len(off)}, off by {np.median(off):.2f} m (median), within 1 m {(off < 1).mean():.2f}")


if __name__ == "__main__":
    main()
