# SPDX-License-Identifier: BSD-3-Clause
"""Slam and localisation assume this of odometry: how it drifts, and how well gravity and a floor hold its poses."""

from collections.abc import Sequence
from typing import Annotated

import numpy as np
from pydantic import Field
from scipy.special import log_softmax

from magmatch.data.survey import Survey
from magmatch.data.units import STATED_OVER
from magmatch.settings import Settings

Deviation = Annotated[float, Field(ge=0, allow_inf_nan=False)]
# Standard deviations after a walk of 10 m: per axis (m), and about each axis that drifts (deg).
Drift = tuple[Deviation, Deviation]
# Drift of steps counted and turned by a phone's own sensors.
DEAD_RECKONING_SD: Drift = (0.5, 6.0)
# What is stated may be a guess, whose logarithm has a standard deviation of 1: factors on it, their prior log odds.
_LOGARITHMS = np.array([0, -1, 1])
FACTORS, FACTOR_ODDS = np.exp(_LOGARITHMS), log_softmax(-0.5 * _LOGARITHMS**2)
# How well gravity and one floor hold at a pose: rad, m.
UPRIGHT_SD, LEVEL_SD = 0.01, 0.05
# Tilt that a body on one floor keeps within, rms: a steady carrier's, not a climber's, rad.
MOST_TILT = np.radians(10.0)


class OdometryConfig(Settings):
    """Drift of odometry: a random walk of position and heading, and two constant errors."""

    sd: Drift = (0.3, 4.0)
    # Lasting errors: of the length of each step, as a share; and of the turn rate, as a share of the random turn over
    # 10 m: good odometry is good in both.
    scale_sd: float = Field(default=0.05, ge=0)
    turn_share: float = Field(default=0.5, ge=0)

    @property
    def drift(self) -> Drift:
        """Standard deviations after a walk of 10 m."""
        return self.sd

    @property
    def translation_sd(self) -> float:
        """Standard deviation of the place after a metre walked, m."""
        return self.drift[0] / float(np.sqrt(STATED_OVER))

    @property
    def rotation_sd(self) -> float:
        """Standard deviation of the heading after a metre walked, rad."""
        return float(np.radians(self.drift[1]) / np.sqrt(STATED_OVER))

    @property
    def turn_rate_sd(self) -> float:
        """Standard deviation of the constant error of the turn rate, rad/m."""
        return float(np.radians(self.turn_share * self.drift[1]) / STATED_OVER)


def lie_level(surveys: Sequence[Survey]) -> bool:
    """Whether all logs keep one height, as well as one floor is trusted to, and their bodies the same way up."""
    return height_of(surveys) is not None and all(_stays_upright(survey) for survey in surveys)


def height_of(surveys: Sequence[Survey]) -> float | None:
    """The height that all logs keep, m, as well as one floor is trusted to; None where they do not."""
    heights = np.concatenate([survey.positions[:, 2] for survey in surveys])
    return float(np.median(heights)) if float(np.ptp(heights)) <= 2 * LEVEL_SD else None


def _stays_upright(survey: Survey) -> bool:
    if survey.orientations is None:
        return True
    # The vertical in the body's axes, wherever those point: a sensor need not be mounted upright.
    up = survey.orientations.inv().apply([0.0, 0.0, 1.0])
    return float(np.linalg.norm(up.mean(axis=0))) > float(np.cos(MOST_TILT))
