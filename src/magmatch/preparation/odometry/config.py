# SPDX-License-Identifier: BSD-3-Clause
"""Settings of dead reckoning; those marked IPIN were chosen on routes 1 to 3 of its training logs of 2023."""

from pydantic import Field

from magmatch.settings import Settings


class DeadReckoningConfig(Settings):
    """Settings of `magmatch.preparation.odometry.dead_reckon.dead_reckon`."""

    # Poses a second. Gyroscopes of phones read 50 to 400 times; a hand turns a degree in 10 ms.
    rate: float = Field(default=100.0, ge=20, le=1000)
    # Rest, at which the gyroscope's bias is learned: turning and acceleration within these (deg/s, m/s^2) of their
    # slow parts. A phone held still in a hand trembles by 2 to 4 deg/s (IPIN), so that VQF's 2 deg/s never hold.
    rest_turning_deg: float = Field(default=6.0, gt=0)
    rest_acceleration: float = Field(default=1.0, gt=0)
    # How well one such rest tells the bias, deg/s: the hand itself turns (IPIN; VQF's 0.03 are for a table).
    rest_bias_sd_deg: float = Field(default=0.1, gt=0)
    # Steps: peaks of the vertical acceleration below this frequency (Hz), so far apart (s), so high above the valleys
    # beside them (m/s^2). People walk at 1.4 to 2.5 steps a second.
    step_frequency: float = Field(default=3.0, gt=0)
    step_interval: float = Field(default=0.35, gt=0)
    step_prominence: float = Field(default=1.0, gt=0)
    # Peaks further apart than this (s) are a stop, not a step.
    longest_step: float = Field(default=1.2, gt=0)
    # Weinberg (2002), Analog Devices AN-602: a step is K (a_max - a_min)^(1/4) long; K in m^(3/4) s^(1/2) (IPIN).
    weinberg_factor: float = Field(default=0.469, gt=0)
    # Relative standard deviations: of K between people (8 %, AN-602), and of one step beside K.
    factor_sd: float = Field(default=0.08, ge=0)
    step_sd: float = Field(default=0.1, ge=0)
