# SPDX-License-Identifier: BSD-3-Clause
"""Attitude of the phone from gyroscope and accelerometer: z is up; the initial heading is arbitrary, and drifts."""

import numpy as np
from scipy.spatial.transform import Rotation

from magmatch.errors import import_extra
from magmatch.typing import Vectors

# Rest, at which the gyroscope's bias is learned: turning and acceleration within these (deg/s, m/s^2) of their slow
# parts. A phone held still in a hand trembles by 2 to 4 deg/s, so that VQF's 2 deg/s never hold (chosen on routes 1
# to 3 of IPIN's training logs of 2023, as is the next).
REST_TURNING_DEG, REST_ACCELERATION = 6.0, 1.0
# How well one such rest tells the bias, deg/s: the hand itself turns; VQF's 0.03 are for a table.
REST_BIAS_SD_DEG = 0.1


def attitude(rate: Vectors, acceleration: Vectors, readings_per_second: float) -> Rotation:
    """Smoothed orientations of the phone at even times, to a frame whose z is up.

    From the gyroscope (rad/s) and the accelerometer (m/s^2, gravity included), phone's axes: VQF without its
    magnetometer, forward and back (Laidig and Seel 2023, 10.1016/j.inffus.2022.10.014). The bias of the gyroscope is
    estimated at rest only: while walking it would absorb the swing of the arm, which made paths of the IPIN logs two
    to four times worse.
    """
    vqf = import_extra("vqf", "dead reckoning", "odometry")
    settings = {
        "motionBiasEstEnabled": False, "restThGyr": REST_TURNING_DEG, "restThAcc": REST_ACCELERATION,
        "biasSigmaRest": REST_BIAS_SD_DEG,
    }  # fmt: skip
    found = vqf.offlineVQF(
        np.ascontiguousarray(rate), np.ascontiguousarray(acceleration), None, 1 / readings_per_second, settings
    )
    return Rotation.from_quat(found["quat6D"], scalar_first=True)
