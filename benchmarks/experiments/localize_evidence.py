"""Whether what a localiser states is true: many starts in CEA, other places, walks off the map, stated probabilities.

    python benchmarks/experiments/localize_evidence.py --data DIR --out DIR [--table starts] [--n 400]
        [--minutes M] [--save NAME]

DIR, its maps and its walks are those of `localize_walks.py`. Rows are kept in OUT and not made again.
starts: walks of 30 m in CEA's walk two, alternately on both floors, with odometry of 0.5, 1 and 3 % and steps in
turn and a bias of up to 30 uT in any direction. off: walks of other places and of the other floor. others: Kok's
square and library, mapped by their first 55 % or their last, the rest walked from its beginning and from its middle;
Aalto's runs of one sensor, each in a map of the two others of another sensor, with made-up odometry of 1 %, run 4
thrice. Late: the path after 15 m. Whole log: what `localize` says of it with hindsight, all else is live.
reliability: before a pose is stated, how probable the best one was said to be, every half metre of all rows, and how
often it was right: within three of the largest standard deviations allowed. Walks off the map weigh as much as the
prior odds say.
"""

import os
from functools import cache, partial
from itertools import pairwise
from pathlib import Path

import numpy as np
from localize_walks import cea, indexed, odometry_of, place_of, quantiles, real_walk, stretch
from scipy.spatial.transform import RigidTransform, Rotation

import magmatch as mm
from magmatch.data.recordings import load_recordings
from magmatch.geometry import path_walked
from magmatch_evaluation.saved_table import saver, show
from magmatch_evaluation.script import arguments, kept
from magmatch_evaluation.statistics import wilson_interval

INFCENTER = "walk1 walk2 walk3 walk4"
WALKS = [f"walk{k}" for k in range(5, 10)]
ROUTES = [f"route{r}_{k}" for r in range(1, 6) for k in range(1, 5)]
EVERY, RIGHT, LATE = 0.5, 1.0, 15.0
BINS = (0.0, 0.01, 0.1, 0.3, 0.5, 0.7, 0.9, 0.99, 1.0001)
LEVELS = ("0.5%", "1%", "3%", "steps")
CONFIG = mm.LocalizerConfig()


@cache
def recording(name, data):
    """Kok's places as they are, Aalto's runs at the robot's true places."""
    return load_recordings(name.split("/")[0], data / name.split("/")[0])[name.split("/")[1]]


def mapped(n, name):
    """Samples of a recording that make its map: the first 55 %, or with #last the last."""
    return np.arange(int(0.45 * n), n) if name.endswith("#last") else np.arange(int(0.55 * n))


def another_place(name, data, out):
    """An indexed map of Kok's or Aalto's, kept."""

    def surveys():
        found = [recording(one.split("#")[0], data) for one in name.split()]
        return [found[0].subset(mapped(len(found[0]), name))] if name.startswith("kok") else found

    return indexed(out / f"{name.replace('/', '-').replace(' ', '-')}.map", surveys)


def map_of(name, data, out):
    return (another_place if "/" in name else place_of)(name, data, out)


def start_in_cea(seed, data):
    """A log of 30 m of walk two on one of CEA's floors, and its true places."""
    rng = np.random.default_rng([21, seed])
    some = stretch(cea(data)["test"][("cea1", "cea2")[seed % 2]], 30.0, rng)
    direction = rng.standard_normal(3)
    bias = rng.uniform(0, 30e-6) * direction / np.linalg.norm(direction)
    log = odometry_of(some[:, :3], some[:, 3:], rng, LEVELS[seed // 2 % 4], bias)
    return log, np.c_[log.times, some[:, :3]]


def log_of(name, data):
    """A log in an odometry's frame, and its true places."""
    source, part = [*name.split("#"), "0"][:2]
    if source == "cea":
        return start_in_cea(int(part), data)
    if "/" not in source:
        return real_walk(source, data)
    survey, rng = recording(source, data), np.random.default_rng(int(part))
    if source.startswith("aalto"):
        log = odometry_of(survey.positions, survey.field, rng, "1%", 0.0)
        return log, np.c_[log.times, survey.positions]
    # All of it (9), or what the first or last 55 % leave: the whole (0, 2), the later half (1, 3).
    rows = np.arange(len(survey))
    if part != "9":
        rows = np.setdiff1d(rows, mapped(len(survey), "#last" if int(part) > 1 else ""))
        rows = rows[int(part) % 2 * len(rows) // 2 :]
    some = survey.subset(rows)
    turn = RigidTransform.from_rotation(Rotation.from_euler("z", rng.uniform(-3, 3)))
    return some.transformed(turn), np.c_[some.times, some.positions]


def work(name, data, out):
    """Follow one log sample by sample: what is stated and whether that is true."""
    _, place_name, log_name = name.split(": ")
    (log, truth), is_there = log_of(log_name, data), not name.startswith("off")
    # What one height means is decided for whole logs: `follow_log`.
    is_planar = np.ptp(log.positions[:, 2]) < 1e-6
    place = map_of(place_name, data, out)
    localizer = mm.Localizer(place, CONFIG.model_copy(update={"is_planar": is_planar}))
    poses = RigidTransform.from_components(log.positions, log.orientations)
    z = log.orientations.inv().apply(log.field)
    walked = path_walked(log.positions)
    d, first, said, errors, nees, asked = truth.shape[1] - 1, None, [], [], [], -np.inf
    true = np.stack([np.interp(log.times, truth[:, 0], c) for c in truth.T[1:]], axis=1)
    n_stated, n_late = 0, 0
    for n, t in enumerate(log.times):
        localizer.update(float(t), poses[n], z[n])
        belief = localizer._maps.best
        n_stated += belief.is_sure
        n_late += belief.is_sure and walked[n] > LATE
        if walked[n] < asked + EVERY:
            continue
        asked = walked[n]
        now = localizer.estimate()
        if now.is_stated:
            off = now.T_map_body.translation[:d] - true[n]
            R = now.T_map_body.rotation.as_matrix()
            C = (R @ now.covariance[3:, 3:] @ R.T)[:d, :d]
            errors.append(float(np.linalg.norm(off)))
            nees.append(float(off @ np.linalg.solve(C, off)) / d)
            first = float(walked[n]) if first is None and errors[-1] < RIGHT else first
        if belief._weighed and first is None:
            T = belief._known.T_map_model @ np.r_[belief._weighed[0].one["p"][0], 1.0]
            limit = CONFIG.decision.tolerance(belief._known.length)[0]
            is_right = is_there and np.linalg.norm(T[:d] - true[n]) < max(limit, RIGHT)
            said.append([belief._found.best, bool(is_right)])
    whole = answered_whole(place, log, true) if is_there else {}
    return whole | {
        "name": name, "walked": float(walked[-1]), "stated": n_stated / len(log), "first": first, "errors": errors,
        "nees": nees, "said": said, "late": float(n_late / max((walked > LATE).sum(), 1)),
    }  # fmt: skip


def answered_whole(place, log, true):
    """What `localize` says of the whole log by default: the share of it stated, and the largest error."""
    track = mm.localize(place, log)
    off = [
        np.linalg.norm(e.T_map_body.translation[: true.shape[1]] - at)
        for e, at in zip(track.estimates, true, strict=True)
        if e.is_stated
    ]
    return {"whole": len(off) / len(log), "whole_off": float(max(off, default=0.0))}


def names(table, n):
    """Rows: ``TABLE: PLACE: LOG``."""
    if table == "starts":
        return [f"starts: {('cea1', 'cea2')[k % 2]}: cea#{k}" for k in range(n)]
    if table == "others":
        kok = [
            f"others: kok/{place}{'#last' if k > 1 else ''}: kok/{place}#{k}"
            for place in ("square", "library") for k in range(4)
        ]  # fmt: skip
        sensors, rows = ("invensense", "trivisio"), []
        for one, two in (sensors, sensors[::-1]):
            for run, others in ((4, (1, 2)), (1, (2, 4)), (2, (1, 4))):
                place = " ".join(f"aalto/{one}-{k}" for k in others)
                rows += [f"others: {place}: aalto/{two}-{run}#{k}" for k in range(3 if run == 4 else 1)]
        return kok + rows
    if table == "off":
        kok = [f"kok/{place}#9" for place in ("mall", "square", "library", "eight")]
        pairs = [("cea1", log) for log in (*WALKS, *ROUTES, *kok)] + [(INFCENTER, log) for log in (*ROUTES, *kok)]
        pairs += [("route3_1 route3_2", log) for log in WALKS] + [("route1_1 route1_2", log) for log in WALKS]
        pairs += [(INFCENTER, f"cea#{k}") for k in range(20)]
        # The other floor.
        pairs += [(("cea2", "cea1")[k % 2], f"cea#{k}") for k in range(500, 620)]
        # In an order of no meaning: a part of them is a sample of all.
        pairs = [pairs[k] for k in np.random.default_rng(0).permutation(len(pairs))]
        return [f"off: {place}: {log}" for place, log in pairs][: None if n >= 100 else n]
    return [row for one in ("starts", "others", "off") for row in names(one, n)]


def of_places(rows):
    """One line: where a pose is stated, and whether it is right."""
    errors, nees = (np.concatenate([row[key] for row in rows]) for key in ("errors", "nees"))
    is_wrong = [bool((np.array(row["errors"]) > RIGHT).any()) for row in rows]
    never = sum(row["first"] is None for row in rows)
    return [
        len(rows), quantiles([row["first"] for row in rows], (0.5, 0.9)), never, sum(is_wrong),
        quantiles(errors, (0.5, 0.95)), f"{np.mean([row['stated'] for row in rows]):.2f}",
        f"{np.mean([row['late'] for row in rows]):.2f}", f"{np.mean(nees):.2f}" if len(nees) else "",
        f"{np.mean([row['whole'] for row in rows]):.2f}", sum(row["whole_off"] > RIGHT for row in rows),
    ]  # fmt: skip


def off_the_map(rows):
    """One line: path, and how much of it had a pose stated."""
    path = sum(row["walked"] for row in rows)
    stated = sum(row["stated"] * row["walked"] for row in rows)
    return [len(rows), f"{path / 1000:.2f}", sum(row["stated"] > 0 for row in rows), f"{stated / path:.4f}"]


def reliability(rows):
    """Share of right poses by stated probability, of walks; intervals of 95 %, of walks on the map and off it."""
    parts = [[row for row in rows if row["name"].startswith("off") == is_off] for is_off in (False, True)]
    n = [max(len(part), 1) for part in parts]
    weight = 1 / CONFIG.decision.prior_odds

    def of_all(share, on, off):
        """Share of right ones among walks on the map, and off it as many as the prior odds say."""
        return share * on / (on + weight * off) if on else 0.0

    table = []
    for low, high in pairwise(BINS):
        # Means of each walk that was ever said to be so probable: stated, right.
        said = ([[s for s in row["said"] if low <= s[0] < high] for row in part] for part in parts)
        on, off = (np.array([np.mean(mine, axis=0) for mine in some if mine]) for some in said)
        rates = [len(some) / n_walks for some, n_walks in zip((on, off), n, strict=True)]
        if not any(rates):
            continue
        sums = on.reshape(-1, 2).sum(axis=0), off.reshape(-1, 2).sum(axis=0)
        stated = (sums[0][0] / n[0] + weight * sums[1][0] / n[1]) / (rates[0] + weight * rates[1])
        right = sums[0][1] / max(len(on), 1)
        shares, most_off = wilson_interval(sums[0][1], len(on)), wilson_interval(len(off), n[1])[::-1]
        bounds = [of_all(share, rates[0], rate) for share, rate in zip(shares, most_off, strict=True)]
        table.append([
            f"{low:g} to {min(high, 1):g}", len(on), len(off), f"{stated:.3f}", f"{of_all(right, *rates):.3f}",
            f"{bounds[0]:.2f} to {bounds[1]:.2f}",
        ])  # fmt: skip
    return table


def main() -> None:
    asked = arguments(
        __doc__, data=Path, out=Path, table="starts", n=400, minutes=np.inf, jobs=os.cpu_count(), save=saver
    )
    wanted = names(asked.table, asked.n)
    run = partial(work, data=asked.data, out=asked.out)
    rows = kept(asked.out / "evidence.jsonl", wanted, run, jobs=asked.jobs, minutes=asked.minutes)
    print(f"{len(rows)} of {len(wanted)} rows")
    found = list(rows.values())
    if asked.table == "reliability":
        columns = ("stated probability", "walks on the map", "off it", "stated", "right", "95 % interval")
        show(columns, reliability(found), asked.save)
        return
    groups = {}
    for row in found:
        _, place, log = row["name"].split(": ")
        label = (place, LEVELS[int(log.split("#")[1]) // 2 % 4]) if asked.table == "starts" else (place, "")
        groups.setdefault(label, []).append(row)
    if asked.table == "off":
        columns = ("map", "walks", "path, km", "walks with a stated pose", "share of the path stated")
        parts = [*((place, some) for (place, _), some in groups.items()), ("all", found)]
        show(columns, [[place, *off_the_map(some)] for place, some in parts], asked.save)
        return
    columns = (
        "map", "odometry", "n", "first right, m", "never", "wrong (1 m)", "error, m", "share stated", "late", "NEES",
        "share, whole log", "wrong, whole log",
    )  # fmt: skip
    lines = [[*label, *of_places(some)] for label, some in groups.items()]
    if asked.table == "starts":
        for label, levels in (("0.5 to 3%", LEVELS[:3]), ("steps", LEVELS[3:])):
            some = [row for (_, level), rows in groups.items() if level in levels for row in rows]
            lines.append(["all", label, *of_places(some)])
    show(columns, [*lines, ["all", "", *of_places(found)]], asked.save)


if __name__ == "__main__":
    main()
