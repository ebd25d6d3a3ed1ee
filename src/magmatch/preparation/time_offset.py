# SPDX-License-Identifier: BSD-3-Clause
"""Initial estimate of the offset between two clocks: where one coarse map explains the rotated field best."""

from collections.abc import Mapping
from dataclasses import replace

import numpy as np

from magmatch.estimation.limits import RANKING_POINTS
from magmatch.field.cholesky.cells import count_active_cells
from magmatch.field.hyperparameters import Hyperparameters
from magmatch.preparation.consistency import LENGTHSCALE_IN_SPACINGS, MapConsistency
from magmatch.preparation.least_squares import CLEARLY, N_STRETCHES, Solution, System
from magmatch.preparation.sensor_log import SensorLog
from magmatch.preparation.sensor_model import sensor_blocks
from magmatch.typing import Points, Scalars

# s, of the first and of the second pass; dips of the curve are some 0.3 s wide, as long as a hand takes to turn.
STEPS = (0.1, 0.025)
# The map: as fine as this many cells allow, never finer than a share of the extent; ordinary field and noise.
MOST_CELLS, FINEST_SHARE = 800, 0.1
SIGNAL_SD, NOISE_SD, STIFFNESS = 10e-6, 0.5e-6, 3000.0


def search_time_offset(log: SensorLog, largest: float, sizes: Mapping[str, float]) -> tuple[float, Solution]:
    """Offset of the readings' stamps (s) at which a coarse map explains the field best, and the sensor errors there.

    0 where no offset is clearly better than none; to within a step of the second pass.

    At a wrong offset the field is turned by the wrong attitude and put at the wrong place. No single map explains
    both, whatever the hard and soft iron, which are estimated along with each trial.
    """
    # The place of the curve, not its depth, is asked for.
    part = log.subset(np.arange(0, len(log), -(-len(log) // RANKING_POINTS)))
    settings = coarse_settings(part.positions)
    trials = {0.0: _solved(part, 0.0, settings, sizes)}
    if log.times is None or largest == 0:
        return 0.0, trials[0.0]
    center, reach = 0.0, largest
    for step in STEPS:
        n = int(reach / step)
        for offset in center + step * np.arange(-n, n + 1):
            if abs(offset) <= largest and not any(abs(offset - known) < 1e-9 for known in trials):
                trials[float(offset)] = _solved(part, float(offset), settings, sizes)
        center, reach = _best(trials), step
    return center, trials[center]


def coarse_settings(points: Points) -> Hyperparameters:
    """Settings of a map that is cheap, whatever the size of the place."""
    extent = float(np.ptp(points, axis=0).max())
    finer = Hyperparameters(LENGTHSCALE_IN_SPACINGS * extent / 2, SIGNAL_SD, NOISE_SD, extent / 2, STIFFNESS)
    while True:
        h, finer = finer, replace(finer, lengthscale=finer.lengthscale / 1.25, spacing=finer.spacing / 1.25)
        if h.spacing <= FINEST_SHARE * extent or count_active_cells(points, finer.spacing, h.reach) > MOST_CELLS:
            return h


def _solved(part: SensorLog, offset: float, settings: Hyperparameters, sizes: Mapping[str, float]) -> Solution:
    """Sensor errors that make the field most consistent at one offset."""
    positions, orientations = part.at(offset)
    R = orientations.as_matrix()
    y = np.einsum("nij,nj->ni", R, part.readings)
    consistency = MapConsistency(positions, settings, np.ones(len(part)))
    return System.of(y, sensor_blocks(R, part.readings, sizes), consistency.project).solve(sizes)


def _best(trials: Mapping[float, Solution]) -> float:
    """Offset of the least misfit; 0 unless it is beaten in stretch after stretch, not by luck of a few."""
    # Cut off at one common limit, so that spikes do not choose.
    limit = 5 * min(solution.noise_sd for solution in trials.values())
    squares: dict[float, Scalars] = {
        offset: np.minimum((solution.free**2).sum(axis=1), 3 * limit**2) for offset, solution in trials.items()
    }
    best = min(squares, key=lambda offset: float(squares[offset].mean()))
    gains = np.array([part.mean() for part in np.array_split(squares[0.0] - squares[best], N_STRETCHES)])
    # In standard errors: of some thirty trials, the best is ahead of a given one by two of them by luck.
    return best if gains.mean() > CLEARLY * gains.std(ddof=1) / np.sqrt(len(gains)) else 0.0
