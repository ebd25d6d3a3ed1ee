# SPDX-License-Identifier: BSD-3-Clause
"""Where to begin: the offset between two clocks at which the turned field hardly changes from reading to reading."""

from collections.abc import Mapping

import numpy as np

from magmatch.preparation.blocks import sensor_blocks
from magmatch.preparation.consistency import increments
from magmatch.preparation.least_squares import N_STRETCHES, Solution, System
from magmatch.preparation.sensor_log import SensorLog
from magmatch.typing import Scalars

# s; hands and wheels turn more slowly than this, so the curve has no narrower dip.
STEP = 0.025
# Standard errors; the best of some eighty trials is ahead of a given one by two or three of them by luck.
CLEARLY = 4.0


def search_time_offset(
    log: SensorLog, largest: float, sizes: Mapping[str, float], weights: Scalars
) -> tuple[float, Solution]:
    """Offset of least change of the turned field, and the sensor's errors that go with it.

    Parameters
    ----------
    log : SensorLog
        Readings that have a pose at every offset searched.
    largest : float, s
        How far to search to either side; 0 looks at the stamps as they are.
    sizes : dict of str to float
        Errors of the sensor that are free, and how large they are expected to be.
    weights : (n,) array
        0 leaves a reading out.

    Returns
    -------
    offset : float, s
        To be added to the readings' stamps; between two steps of the search by a parabola. 0 where no offset is
        clearly better than none: near strong sources the place changes the field more than turning does.
    solution : Solution
        At the best step.

    Notes
    -----
    A sensor that turns sees a still field turn the other way, ``R(t + offset) (M b - d)`` does not change; what the
    place itself changes is noise here. M and d are found along with each trial offset, so a hard iron of any size
    does not hide the turning.
    """
    n_steps = int(np.ceil(largest / STEP)) if log.times is not None else 0
    offsets = STEP * np.arange(-n_steps, n_steps + 1)
    project = increments(len(log), log.times, weights)
    solutions = []
    for offset in offsets:
        R = log.at(float(offset))[1].as_matrix()
        y = np.einsum("nij,nj->ni", R, log.readings)
        solutions.append(System.of(y, sensor_blocks(R, log.readings, sizes), project).solve(sizes))
    squares = _bounded_squares(solutions)
    change = squares.mean(axis=1)
    best, as_stamped = int(np.argmin(change)), n_steps
    if not _is_clearly_less(squares[best], squares[as_stamped]):
        return 0.0, solutions[as_stamped]
    offset = float(offsets[best])
    if 0 < best < len(offsets) - 1:
        before, here, after = change[best - 1 : best + 2]
        offset += STEP * 0.5 * (before - after) / max(before - 2 * here + after, 1e-300)
    return offset, solutions[best]


def _bounded_squares(solutions: list[Solution]) -> np.ndarray:
    """Square of each change at each trial, large ones cut off at one common limit so that spikes do not choose."""
    limit = 5 * min(solution.noise_sd for solution in solutions)
    squares = [(solution.residual**2).sum(axis=1) for solution in solutions]
    return np.minimum(squares, 3 * limit**2)


def _is_clearly_less(squares: Scalars, others: Scalars) -> bool:
    """Whether one trial changes less than another in stretch after stretch, not by luck of a few."""
    gains = np.array([part.mean() for part in np.array_split(others - squares, N_STRETCHES)])
    return bool(gains.mean() > CLEARLY * gains.std(ddof=1) / np.sqrt(len(gains)))
