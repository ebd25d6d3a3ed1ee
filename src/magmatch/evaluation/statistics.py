# SPDX-License-Identifier: BSD-3-Clause
"""What many trials say together: pure functions, in which a failure is never left out silently."""

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from magmatch.evaluation.experiment import Tolerance
from magmatch.evaluation.rows import Row

# Two-sided 95 % of a normal distribution.
Z95 = 1.959963984540054


@dataclass(frozen=True, slots=True)
class Spread:
    """An error over many trials; trials without any pose count as infinitely far off in median and p95.

    Attributes
    ----------
    rmse, sd : float
        Root mean square and standard deviation as published: of the best pose of every trial that has one, accepted
        or not. How many have one stands in `Summary.n_posed`.
    median, p95 : float
        Over all trials.
    """

    rmse: float
    sd: float
    median: float
    p95: float


@dataclass(frozen=True, slots=True)
class Summary:
    """One method in one experiment.

    Attributes
    ----------
    n : int
        Trials.
    n_posed, n_accepted, n_right : int
        With any pose; accepted; accepted and within tolerance.
    n_false : int
        Accepted though out of tolerance, or though there was nothing to find.
    n_faults : int
        Broke down.
    success : (float, float)
        Wilson's 95 % interval of the rate of `n_right` (of refusals, where there is nothing to find).
    distance, angle_deg : Spread
        m, deg.
    nees : float
        Mean per degree of freedom over accepted trials that state a covariance; NaN without any.
    seconds : float
        Median.
    peak_bytes : int
        Largest.
    """

    n: int
    n_posed: int
    n_accepted: int
    n_right: int
    n_false: int
    n_faults: int
    success: tuple[float, float]
    distance: Spread
    angle_deg: Spread
    nees: float
    seconds: float
    peak_bytes: int


def summarize(rows: Sequence[Row], tolerance: Tolerance) -> Summary:
    """Sum up the trials of one method in one experiment.

    Parameters
    ----------
    rows : sequence of Row
        At least one.
    tolerance : Tolerance

    Returns
    -------
    Summary
    """
    accepted = [row for row in rows if row.is_accepted]
    wrong = [row for row in accepted if not is_right(row, tolerance)]
    n_right = len(accepted) - len(wrong)
    n_refused = sum(not row.is_there and not row.is_accepted and row.status != "fault" for row in rows)
    stated = [row.nees for row in accepted if not math.isnan(row.nees)]
    return Summary(
        n=len(rows),
        n_posed=sum(math.isfinite(row.distance) for row in rows),
        n_accepted=len(accepted),
        n_right=n_right,
        n_false=len(wrong),
        n_faults=sum(row.status == "fault" for row in rows),
        success=wilson_interval(n_right + n_refused, len(rows)),
        distance=spread([row.distance for row in rows]),
        angle_deg=spread([math.degrees(row.angle) for row in rows]),
        nees=float(np.mean(stated)) if stated else math.nan,
        seconds=float(np.median([row.seconds for row in rows])),
        peak_bytes=max(row.peak_bytes for row in rows),
    )


def is_right(row: Row, tolerance: Tolerance) -> bool:
    """Whether the best pose of a trial is within tolerance of a truth that is there."""
    is_near = row.distance <= tolerance.distance and math.degrees(row.angle) <= tolerance.angle_deg
    return row.is_there and is_near


def spread(errors: Sequence[float]) -> Spread:
    """Sum up errors of which some may be infinite.

    Parameters
    ----------
    errors : sequence of float
        At least one, not negative.

    Returns
    -------
    Spread
    """
    values = np.sort(np.asarray(errors, dtype=np.float64))
    finite = values[np.isfinite(values)]
    rmse, sd = (float(np.sqrt(np.mean(finite**2))), float(np.std(finite))) if len(finite) else (math.inf, math.nan)
    return Spread(rmse, sd, quantile(values, 0.5), quantile(values, 0.95))


def quantile(ordered: np.ndarray, q: float) -> float:
    """Return the smallest value that at least a share q does not exceed: never between a number and infinity."""
    return float(ordered[max(math.ceil(q * len(ordered) - 1e-9) - 1, 0)])


def wilson_interval(n_successes: int, n: int, z: float = Z95) -> tuple[float, float]:
    """Interval of a probability from counts.

    Parameters
    ----------
    n_successes, n : int
    z : float
        Quantile of the normal distribution.

    Returns
    -------
    low, high : float
        (0, 1) without any trial.

    Notes
    -----
    Both roots of ``(p - k/n)^2 = z^2 p (1 - p) / n``.

    References
    ----------
    E. B. Wilson, Probable inference, the law of succession, and statistical inference, JASA 22, 1927,
    doi:10.1080/01621459.1927.10502953.

    Examples
    --------
    >>> [round(p, 3) for p in wilson_interval(20, 20)]
    [0.839, 1.0]
    """
    if n == 0:
        return 0.0, 1.0
    rate = n_successes / n
    center = rate + z**2 / (2 * n)
    half = z * math.sqrt(rate * (1 - rate) / n + z**2 / (4 * n**2))
    scale = 1 + z**2 / n
    # The roots lie in [0, 1] by law; rounding may leave it.
    return max(0.0, (center - half) / scale), min(1.0, (center + half) / scale)
