"""Walks in a known map from an unknown start: first fix, error, wrong fixes, and whether what is stated is true.

    python benchmarks/experiments/localize_walks.py --data DIR --out DIR [--sets cea1,infcenter,museum] [--n 20]
        [--cases outside,stairs] [--live] [--quick] [--save NAME]

DIR holds ``cea/corridor_*.csv``: walk one is the map, walk two is walked with its true field and with odometry that
is made up (drift, scale, a phone that is tilted, a sensor's bias); ``dodolilo/infcenter`` and ``ipin2023/pdr``: walks
with their own odometry, in maps of other walks at true positions (``make_surveys.py`` of DIR).
Sets: cea1 and cea2 (floors), cea (both floors in one map), infcenter, museum. Cases of cea: odometry of 0.5, 1 and 3
%, steps, bias; `kidnapped` after 30 m; `jump5` to `jump30`, of the bias (uT), after 25 m; `outside`: after 30 m the
body leaves the map for 40 m and comes back (error, share and NEES are of that part); `stairs` and `lift`, in the map
of both floors: to the other floor after 30 m, odometry seeing the rise of stairs but not of a lift; `elsewhere`,
walks on the other floor. Error: distance in the map's frame without any alignment, horizontal where the truth is.
Tuned on cea1, infcenter walks 5 and 6, museum routes 1 to 3. A wrong run states a pose more than 1 m off (kidnapped,
lift: after it was lost; outside, stairs: once it left; elsewhere: any). Lost for: path from the end of such a change
to the next right pose. Cost: a sample that is tracked, and a search, over an evaluation of field and gradient at a
point (of a batch of 4,000).
"""

import csv
import os
import subprocess
import sys
from functools import cache, partial
from pathlib import Path

import numpy as np
from scipy.ndimage import gaussian_filter1d
from scipy.spatial.transform import RigidTransform, Rotation

import magmatch as mm
from magmatch.data.formats.format import SurveyFormat
from magmatch.field.config import SPLINE
from magmatch.geometry import path_walked
from magmatch.localization.localize import localize
from magmatch.registration.index.map_index import prepare_index
from magmatch_evaluation.saved_table import saver, show
from magmatch_evaluation.script import arguments, kept, timed

COLUMNS = (
    "set", "case", "n", "first right, m", "never", "wrong", "error, m", "share", "after first", "NEES", "lost for, m",
    "s a metre",
)  # fmt: skip
# Odometry: scale (sd), then per root of a metre: heading (deg) and place (m); vertical (m); tilt (deg).
LEVELS = {
    "0.5%": (0.003, 0.10, 0.010, 0.003, 0.2),
    "1%": (0.010, 0.25, 0.020, 0.005, 0.3),
    "3%": (0.030, 0.60, 0.050, 0.010, 0.5),
    "steps": (0.075, 1.00, 0.080, 0.020, 1.0),
}
FLOORS = ("stairs", "lift")
CASES = (*LEVELS, "bias", "kidnapped", "jump5", "jump15", "jump30", "outside", *FLOORS, "elsewhere")
LENGTHS = {"elsewhere": 100.0}


def odometry_of(p, b, rng, level, bias):
    """A log of a body at places p that feels b (map's axes): heading along its path, carried with some tilt."""
    scale_sd, heading_walk, place_walk, height_walk, tilt = LEVELS[level]
    n, is_phone = len(p), level == "steps"
    step = np.r_[0.0, np.linalg.norm(np.diff(p, axis=0), axis=1)]
    v = np.gradient(gaussian_filter1d(p, 8, axis=0), axis=0)
    heading = np.unwrap(np.arctan2(v[:, 1], v[:, 0])) + is_phone * rng.uniform(-np.pi, np.pi)
    sway = np.sqrt(15 * 3.5) * gaussian_filter1d(rng.standard_normal((n, 2)), 15, axis=0) * (4.0 if is_phone else 1.0)
    R = Rotation.from_euler("ZYX", np.c_[heading, np.radians(25.0 * is_phone + sway[:, 0]), np.radians(sway[:, 1])])
    sign = rng.choice([-1, 1]) * rng.uniform(0.05, 0.10) if is_phone else scale_sd * rng.standard_normal()
    drift = np.cumsum(np.radians(heading_walk) * np.sqrt(step) * rng.standard_normal(n)) + rng.uniform(-np.pi, np.pi)
    tilts = np.radians(tilt) * np.sqrt(60 * 3.5) * gaussian_filter1d(rng.standard_normal((n, 2)), 60, axis=0)
    turned = Rotation.from_euler("z", drift[:, None])
    moves = turned[:-1].apply(np.diff(p, axis=0) * (1 + sign))
    moves += np.sqrt(step[1:, None]) * [place_walk, place_walk, height_walk] * rng.standard_normal((n - 1, 3))
    wrong = turned * Rotation.from_rotvec(np.c_[tilts, np.zeros(n)]) * R
    z = R.inv().apply(b) + 0.3e-6 * rng.standard_normal((n, 3)) + bias
    places = np.vstack([np.zeros(3), np.cumsum(moves, axis=0)])
    return mm.Survey(places, wrong.apply(z), np.cumsum(step + 1e-6) / 0.8, wrong, name="walk")


@cache
def cea(data):
    """Walk one and walk two, by floor: places (m) and field (T)."""
    parts = {}
    for walk in ("training", "test"):
        rows = np.loadtxt(data / "cea" / f"corridor_{walk}.csv", delimiter=",") * [1, 1, 1, 1e-6, 1e-6, 1e-6]
        is_low = rows[:, 2] < 4.5
        parts[walk] = {"cea1": rows[is_low], "cea2": rows[~is_low], "cea": rows}
    return parts


@cache
def place_of(name, data, out):
    """An indexed map, kept: of a part of CEA's walk one, or of walks at true positions."""

    def surveys():
        if not name.startswith("cea"):
            return [survey_at_truth(walk, data, out) for walk in name.split()]
        rows = cea(data)["training"][name]
        return mm.Survey(rows[:, :3], rows[:, 3:], name=name)

    return indexed(out / f"{name.replace(' ', '-')}.map", surveys)


def indexed(path, surveys):
    """The map at a path with its index, each made where it is not there yet."""
    if not path.exists():
        mm.build_map(surveys(), SPLINE).save(path)
    return prepare_index(mm.FieldMap.load(path))


def file_of(walk, data):
    """A walk with its odometry: ``walk3`` of infcenter, or ``route1_2`` of the museum."""
    return data / ("dodolilo/infcenter" if walk.startswith("walk") else "ipin2023/pdr") / f"{walk}.csv"


def truth_of(walk, data):
    return file_of(walk, data).with_name(f"{walk}_truth.csv")


def survey_at_truth(walk, data, out):
    """A walk at its true positions, made once."""
    made = out / f"{walk}_true.csv"
    if not made.exists():
        words = [sys.executable, data / "make_surveys.py", file_of(walk, data), truth_of(walk, data), made]
        subprocess.run([str(word) for word in words], check=True)
    return mm.read_survey(made, SurveyFormat(field_frame="sensor"))


def real_walk(walk, data):
    """A walk with its odometry, and time, x, y of the true points."""
    log = mm.read_survey(file_of(walk, data), SurveyFormat(field_frame="sensor"))
    with truth_of(walk, data).open() as lines:
        return log, np.array([[float(row[key]) for key in ("t", "x", "y")] for row in csv.DictReader(lines)])


def stretch(rows, length, rng):
    """A stretch of a walk (rows of place and field) that begins anywhere."""
    walked = path_walked(rows[:, :3])
    first = rng.uniform(0, walked[-1] - length)
    return rows[(walked >= first) & (walked <= first + length)]


def beside(p, q, shape, foreign, field_map, rng):
    """Rows of a way from p to q, straight but for `shape` (m), through a field that the map does not contradict.

    It is drawn from the map's posterior; the less the map knows there, the more it is that of some foreign rows.
    """
    way = p[:3] + np.linspace(0, 1, len(shape))[:, None] * (q - p)[:3] + shape
    variance = np.trace(field_map.covariance(way), axis1=1, axis2=2) / 3
    known = (field_map.knows(way) / (1 + variance / foreign[:, 3:].var(axis=0).mean()))[:, None]
    first = rng.integers(len(foreign) - len(way))
    field = known * field_map.draw(way, 1, 0, rng)[0].field + (1 - known) * foreign[first : first + len(way), 3:]
    # What was measured at both ends is carried a metre on.
    along = path_walked(way)[:, None]
    field += np.exp(-along) * (p[3:] - field[0]) + np.exp(along - along[-1]) * (q[3:] - field[-1])
    return np.c_[way, field][1:-1]


def out_and_back(rows, foreign, field_map, rng):
    """30 m of rows, 40 m out of the map from its rim and back, 30 m on; where it leaves and where it is back."""
    walked = path_walked(rows[:, :3])
    is_far = (walked > 30.0) & (walked < walked[-1] - 30.0)
    away = rng.uniform(0, 2 * np.pi)
    away = np.array([np.cos(away), np.sin(away), 0.0])
    k = np.flatnonzero(is_far)[np.argmax(rows[is_far, :3] @ away)]
    angle = np.linspace(0, 2 * np.pi, 600)[:, None]
    # As long as 40 m, and 1 m wide.
    shape = 9.95 * (1 - np.cos(angle)) * away + 0.5 * np.sin(angle) * np.cross([0, 0, 1], away)
    before, after = (
        rows[(walked >= a) & (walked <= b)] for a, b in ((walked[k] - 30, walked[k]), (walked[k], walked[k] + 30))
    )
    return [before, beside(before[-1], after[0], shape, foreign, field_map, rng), after]


def to_another_floor(floors, field_map, rng):
    """30 m on one floor, a turn of stairs, 30 m on the other from there."""
    one, other = floors if rng.uniform() < 0.5 else floors[::-1]
    (walked, p), (walked_there, q) = ((path_walked(rows[:, :3]), rows) for rows in (one, other))
    is_long = np.flatnonzero(walked_there < walked_there[-1] - 30.0)
    k, near, apart = 0, 0, np.inf
    # Where the floors lie over each other.
    while walked[k] < 30.0 or apart > 1.5:
        k = rng.integers(len(p))
        gaps = np.linalg.norm(q[is_long, :2] - p[k, :2], axis=1)
        near, apart = is_long[np.argmin(gaps)], gaps.min()
    before = p[(walked >= walked[k] - 30.0) & (walked <= walked[k])]
    after = q[(walked_there >= walked_there[near]) & (walked_there <= walked_there[near] + 30.0)]
    angle = np.linspace(0, 2 * np.pi, 140)[:, None]
    shape = 1.5 * np.c_[np.cos(angle) - 1, np.sin(angle), 0 * angle]
    return [before, beside(before[-1], after[0], shape, q, field_map, rng), after]


def walk_of(floor, case, seed, data, field_map):
    """A log of a case, its true places, and the samples at which the body leaves and is back, where it does."""
    rng = np.random.default_rng(seed)
    there = {"cea1": "cea2", "cea2": "cea1"}[floor] if case == "elsewhere" else floor
    rows = cea(data)["test"][there]

    def part(length):
        return np.hsplit(stretch(rows, length, rng), 2)

    direction = rng.standard_normal(3)
    direction /= np.linalg.norm(direction)
    level = case if case in LEVELS else "1%"
    if case == "outside" or case in FLOORS:
        low, high = (cea(data)["test"][one] for one in ("cea1", "cea2"))
        # Of a map of both floors, the body leaves the lower.
        parts = (
            to_another_floor((low, high), field_map, rng) if case in FLOORS
            else out_and_back(*((high, low) if floor == "cea2" else (low, high)), field_map, rng)
        )  # fmt: skip
        path, ends = np.vstack(parts), np.cumsum([len(part) for part in parts])
        seen = path[:, :3].copy()
        if case == "lift":
            rise = seen[ends[1], 2] - seen[ends[0] - 1, 2]
            path, seen = (np.delete(x, np.s_[ends[0] : ends[1]], axis=0) for x in (path, seen))
            seen[ends[0] :, 2] -= rise
            ends[1] = ends[0]
        return odometry_of(seen, path[:, 3:], rng, level, 0.0), path[:, :3], ends[:2]
    if case == "kidnapped":
        (p, b), (q, c) = part(30.0), part(30.0)
        one, other = odometry_of(p, b, rng, level, 0), odometry_of(q, c, rng, level, 0)
        ends = [RigidTransform.from_components(x.positions[k], x.orientations[k]) for x, k in ((one, -1), (other, 0))]
        # Only the heading jumps: the odometry knows the vertical.
        turn = Rotation.from_euler("z", (ends[0].rotation * ends[1].rotation.inv()).as_euler("zyx")[0])
        T = RigidTransform.from_components(one.positions[-1] - turn.apply(other.positions[0]), turn)
        moved = other.transformed(T)
        log = mm.Survey(
            np.vstack([one.positions, moved.positions]), np.vstack([one.field, moved.field]),
            np.r_[one.times, one.times[-1] + 0.5 + moved.times],
            Rotation.concatenate([one.orientations, moved.orientations]), name="walk",
        )  # fmt: skip
        return log, np.vstack([p, q]), [len(p), len(p)]
    p, b = part(LENGTHS.get(case, 60.0))
    bias = 30e-6 * direction * rng.uniform() if case == "bias" else 0.0
    if case.startswith("jump"):
        walked = path_walked(p)
        bias = np.where(walked[:, None] > 25.0, float(case[4:]) * 1e-6 * direction, 0.0)
    return odometry_of(p, b, rng, level, bias), p, None


def changed(rows, error, walked, is_stated, leaves, back):
    """Of stated samples, how far the body was known right again once it was back, and how many were wrong."""
    is_late = rows >= back
    last = rows[(error > 1.0) & is_late].max(initial=back)
    again = rows[(error < 1.0) & is_late & (rows >= last)]
    # A body that was put down where it had been is never lost.
    gone = np.flatnonzero((np.arange(len(walked)) >= back) & ~is_stated)
    later = is_late & (rows > (gone[0] if len(gone) else -1)) if leaves == back else rows >= leaves
    return {
        "again": float(walked[again[0]] - walked[back]) if len(again) else None,
        "wrong": float(np.mean(error[later] > 1.0)) if later.any() else 0.0,
    }


def work(name, data, out, live):
    place_name, case, seed = name.split(": ")
    place = place_of(place_name, data, out)
    if place_name.startswith("cea"):
        log, p, ends = walk_of(place_name, case, int(seed), data, place.field_map)
        truth = np.c_[log.times, p]
    else:
        (log, truth), ends = real_walk(case, data), None
    track, seconds, _ = timed(localize, place, log, mm.LocalizerConfig(), live=live)
    seconds -= track.seconds["map"]
    walked = path_walked(log.positions)
    stated = np.flatnonzero(track.is_stated)
    row = {"name": name, "walked": float(walked[-1]), "seconds": seconds, "share": len(stated) / len(log)}
    if not len(stated) or case == "elsewhere":
        return row | {"first": None, "error": [], "nees": [], "wrong": len(stated) / len(log), "after": 0.0}
    poses, d = track.poses, truth.shape[1] - 1
    at = log.times[stated]
    # Truth at the stated poses, or the stated poses at the few true points.
    if len(truth) > len(log) / 4:
        is_in = (at >= truth[0, 0]) & (at <= truth[-1, 0])
        rows, true = stated[is_in], np.stack([np.interp(at[is_in], truth[:, 0], c) for c in truth.T[1:]], axis=1)
    else:
        near = np.clip(np.searchsorted(log.times, truth[:, 0]), 0, len(log) - 1)
        is_in = np.isin(near, stated)
        rows, true = near[is_in], truth[is_in, 1:]
    which = np.searchsorted(stated, rows)
    off = poses.translation[which][:, :d] - true
    R = poses.rotation.as_matrix()[which]
    C = np.array([R[k] @ track.estimates[n].covariance[3:, 3:] @ R[k].T for k, n in enumerate(rows)])
    C = C.reshape(-1, 3, 3)
    nees = np.einsum("ni,nij,nj->n", off, np.linalg.inv(C[:, :d, :d]), off) / d
    error = np.linalg.norm(off, axis=1)
    right = rows[error < 1.0]
    first = float(walked[right[0]]) if len(right) else None
    wrong = float(np.mean(error > 1.0)) if len(error) else 0.0
    row |= {"first": first, "after": float(track.is_stated[stated[0] :].mean())}
    if ends is not None:
        row |= changed(rows, error, walked, track.is_stated, *ends)
        wrong = row["wrong"]
        own = (rows >= ends[0]) & (rows < ends[1]) if case == "outside" else rows < ends[0]
        error, nees = error[own], nees[own]
        if case == "outside":
            row["share"] = float(track.is_stated[slice(*ends)].mean())
    few = slice(None, None, max(len(error) // 200, 1))
    return row | {"error": error[few].tolist(), "nees": nees[few].tolist(), "wrong": wrong}


def names(sets, n, cases=CASES):
    """Rows of all sets: ``PLACE: CASE: SEED``."""
    for one in sets:
        if one == "infcenter":
            yield from (f"walk1 walk2 walk3 walk4: walk{k}: 0" for k in range(5, 10))
        elif one == "museum":
            for r in range(1, 6):
                yield from (f"route{r}_{a} route{r}_{a + 1}: route{r}_{b}: 0" for a, b in ((1, 3), (3, 1)))
        else:
            own = [case for case in cases if (case not in FLOORS if one != "cea" else case != "elsewhere")]
            yield from (f"{one}: {case}: {k}" for case in own for k in range(n))


def quantiles(values, shares):
    """Some quantiles; None, which never happened, comes last."""
    values = [np.inf if v is None else v for v in values]
    return " / ".join(f"{np.quantile(values, q, method='nearest'):.2f}" for q in shares) if values else ""


def cells(label, case, rows):
    first = [row["first"] for row in rows]
    error, nees = (np.concatenate([row[key] for row in rows]) for key in ("error", "nees"))
    again = [row["again"] for row in rows if "again" in row]
    after = [row["after"] for row in rows if row["first"] is not None]
    seconds = sum(row["seconds"] for row in rows) / sum(row["walked"] for row in rows)
    return [
        label, case, len(rows), quantiles(first, (0.5, 0.9)), first.count(None),
        sum(row["wrong"] > 0 for row in rows), quantiles(error, (0.5, 0.75, 0.95)),
        f"{np.mean([row['share'] for row in rows]):.2f}", f"{np.mean(after or [0.0]):.2f}",
        f"{np.mean(nees):.2f}" if len(nees) else "", quantiles(again, (0.5, 0.9)), f"{seconds:.3f}",
    ]  # fmt: skip


def cost(place, data):
    """Mean time of a sample that is tracked, and of the longest search, over an evaluation at a point; in s, too."""
    field_map, rng = place.field_map, np.random.default_rng(0)
    points = field_map.survey.positions[rng.integers(len(field_map.survey), size=4000)]
    log, *_ = walk_of("cea1", "1%", 0, data, field_map)
    poses = RigidTransform.from_components(log.positions, log.orientations)
    z, times, one = log.orientations.inv().apply(log.field), [], []
    # The first run compiles; each sample's best of the others counts: what else runs on the machine does not.
    for _ in range(6):
        localizer, is_stated = mm.Localizer(place), []
        one.append(timed(field_map.evaluate, points, 1).processor / len(points))
        times.append([])
        for n, t in enumerate(log.times):
            is_stated.append(localizer.estimate().is_stated)
            times[-1].append(timed(localizer.update, float(t), poses[n], z[n]).processor)
    best, one = np.min(times[1:], axis=0), min(one[1:])
    tracked, searched = best[is_stated].mean(), best[~np.array(is_stated)].max()
    return tracked / one, searched / one, 1e6 * one


def main() -> None:
    asked = arguments(
        __doc__, data=Path, out=Path, sets="cea1,infcenter,museum", cases=",".join(CASES), n=20, live=False,
        quick=False, jobs=os.cpu_count(), save=saver,
    )  # fmt: skip
    asked.out.mkdir(parents=True, exist_ok=True)
    wanted = list(names(asked.sets.split(","), 1 if asked.quick else asked.n, asked.cases.split(",")))
    for place in dict.fromkeys(name.split(": ")[0] for name in wanted):
        place_of(place, asked.data, asked.out)
    file = asked.out / ("live.jsonl" if asked.live else "walks.jsonl")
    rows = kept(file, wanted, partial(work, data=asked.data, out=asked.out, live=asked.live), jobs=asked.jobs)
    groups = {}
    for name in wanted:
        place, case, _ = name.split(": ")
        if name in rows:
            label = place if place.startswith("cea") else "infcenter" if place.startswith("walk") else "museum"
            tuned = label == "cea1" or case in ("walk5", "walk6") or case[:6] in ("route1", "route2", "route3")
            groups.setdefault((label + (", tuned on" if tuned else ""), case), []).append(rows[name])
    table = [cells(label, case, found) for (label, case), found in groups.items()]
    show(COLUMNS, table, asked.save)
    costs = [
        (one, *(f"{x:.3g}" for x in cost(place_of(one, asked.data, asked.out), asked.data)))
        for one in ("cea1", "cea")
        if one in asked.sets.split(",") and not asked.quick
    ]
    show(("map", "a tracked sample", "a search", "evaluation, us"), costs)


if __name__ == "__main__":
    main()
