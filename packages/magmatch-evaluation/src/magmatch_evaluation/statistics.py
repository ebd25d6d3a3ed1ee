# SPDX-License-Identifier: BSD-3-Clause
"""What many trials say together: pure functions, in which a failure is never left out silently."""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from magmatch_evaluation.experiments import Experiment, Tolerance
from magmatch_evaluation.rows import AnyRow, Row

# Two-sided 95 % of a normal distribution.
Z95 = 1.959963984540054
OURS = "default"
# Methods that are told roughly where the answer is compete with nobody.
PRIVILEGED = ("gicp", "refine-rough")


@dataclass(frozen=True, slots=True)
class Spread:
    """An error over many trials.

    Root mean square and standard deviation are as published: of the best pose of every trial that has one, accepted
    or not. Median and 95 % are over all trials, those without any pose as infinitely far off.
    """

    rmse: float
    sd: float
    median: float
    p95: float


@dataclass(frozen=True, slots=True)
class Summary:
    """One method in one experiment."""

    n: int  # trials
    n_posed: int  # with any pose
    n_right: int  # accepted and within tolerance
    n_false: int  # accepted though out of tolerance, or though there was nothing to find
    n_faults: int  # broke down
    # (float, float): wilson's 95 % interval of the rate of `n_right` (of refusals, where there is nothing to find)
    success: tuple[float, float]
    distance: Spread  # m, deg
    angle_deg: Spread
    nees: float  # mean per degree of freedom over accepted trials that state a covariance; NaN without any
    seconds: float  # median
    peak_bytes: int  # of the trial with the least: a process keeps what trials before it used


# By (experiment, method), in the order of the experiments and their methods.
Summaries = Mapping[tuple[str, str], Summary]


def summaries(experiments: Sequence[Experiment], rows: Sequence[AnyRow]) -> Summaries:
    """Sum up the registrations among some rows."""
    grouped: dict[tuple[str, str], list[Row]] = {}
    for row in rows:
        if isinstance(row, Row):
            grouped.setdefault((row.experiment, row.method), []).append(row)
    return {
        (e.name, method): summarize(grouped[e.name, method], e.tolerance)
        for e in experiments for method in e.methods if (e.name, method) in grouped
    }  # fmt: skip


def summarize(rows: Sequence[Row], tolerance: Tolerance) -> Summary:
    """Sum up the trials, at least one, of one method in one experiment."""
    accepted = [row for row in rows if row.is_accepted]
    n_right = sum(is_right(row, tolerance) for row in accepted)
    n_refused = sum(not row.is_there and not row.is_accepted and row.status != "fault" for row in rows)
    stated = [row.nees for row in accepted if not math.isnan(row.nees)]
    return Summary(
        n=len(rows),
        n_posed=sum(math.isfinite(row.distance) for row in rows),
        n_right=n_right,
        n_false=len(accepted) - n_right,
        n_faults=sum(row.status == "fault" for row in rows),
        success=wilson_interval(n_right + n_refused, len(rows)),
        distance=spread([row.distance for row in rows]),
        angle_deg=spread([math.degrees(row.angle) for row in rows]),
        nees=float(np.mean(stated)) if stated else math.nan,
        seconds=float(np.median([row.seconds for row in rows])),
        peak_bytes=min(row.peak_bytes for row in rows),
    )


def is_right(row: Row, tolerance: Tolerance) -> bool:
    """Whether the best pose of a trial is within tolerance of a truth that is there."""
    is_near = row.distance <= tolerance.distance and math.degrees(row.angle) <= tolerance.angle_deg
    return row.is_there and is_near


def spread(errors: Sequence[float]) -> Spread:
    """Sum up errors, at least one, of which some may be infinite."""
    values = np.asarray(errors, dtype=np.float64)
    finite = values[np.isfinite(values)]
    rmse, sd = (float(np.sqrt(np.mean(finite**2))), float(np.std(finite))) if len(finite) else (math.inf, math.nan)
    # Errors that were seen: never between a number and infinity.
    median, p95 = np.quantile(values, [0.5, 0.95], method="inverted_cdf").tolist()
    return Spread(rmse, sd, median, p95)


def wilson_interval(n_successes: int, n: int) -> tuple[float, float]:
    """Interval of a probability from counts: both roots of ``(p - k/n)^2 = z^2 p (1 - p) / n``; (0, 1) without trial.

    E. B. Wilson, JASA 22, 1927, doi:10.1080/01621459.1927.10502953.

    Examples
    --------
    >>> [round(p, 3) for p in wilson_interval(20, 20)]
    [0.839, 1.0]
    """
    if n == 0:
        return 0.0, 1.0
    rate, z = n_successes / n, Z95
    center = rate + z**2 / (2 * n)
    half = z * math.sqrt(rate * (1 - rate) / n + z**2 / (4 * n**2))
    scale = 1 + z**2 / n
    # The roots lie in [0, 1] by law; rounding may leave it.
    return max(0.0, (center - half) / scale), min(1.0, (center + half) / scale)


def shortfalls(found: Summaries) -> list[str]:
    """List where another method did better than ours, a line each.

    Better is: more right answers, fewer wrong ones, or as many right and a smaller median error.
    """
    lines = []
    for (experiment, method), other in found.items():
        ours = found.get((experiment, OURS))
        if ours is None or method == OURS or method in PRIVILEGED:
            continue
        if better := _better(other, ours):
            lines.append(f"{experiment}: {method} {' and '.join(better)}.")
    return lines


def _better(other: Summary, ours: Summary) -> list[str]:
    """Words for each figure in which another method was better."""
    if other.n_right > ours.n_right:
        return [f"was right in {other.n_right} of {other.n}, {OURS} in {ours.n_right} of {ours.n}"]
    better = []
    if other.n_false < ours.n_false:
        better.append(f"accepted wrongly {other.n_false} times, {OURS} {ours.n_false} times")
    if other.n_right == ours.n_right > 0:
        for theirs, mine, scale, unit in (
            (other.distance.median, ours.distance.median, 1e3, ".1f} mm"),
            (other.angle_deg.median, ours.angle_deg.median, 1.0, ".2f} deg"),
        ):
            if theirs < mine:
                shown = ("{:" + unit).format
                better.append(f"had a median error of {shown(scale * theirs)}, {OURS} {shown(scale * mine)}")
    return better
