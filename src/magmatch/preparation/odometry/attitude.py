# SPDX-License-Identifier: BSD-3-Clause
"""Attitude of the phone from gyroscope and accelerometer: z is up; the initial heading is arbitrary, and drifts."""

import numpy as np
from scipy.spatial.transform import Rotation

from magmatch.errors import import_extra
from magmatch.preparation.odometry.config import DeadReckoningConfig
from magmatch.typing import Vectors


def attitude(rate: Vectors, acceleration: Vectors, config: DeadReckoningConfig) -> Rotation:
    """Smoothed orientations of the phone at even times, to a frame whose z is up.

    From the gyroscope (rad/s) and the accelerometer (m/s^2, gravity included), phone's axes, ``config.rate`` times a
    second: VQF without its magnetometer, forward and back (Laidig and Seel 2023, 10.1016/j.inffus.2022.10.014). The
    bias of the gyroscope is estimated at rest only: while walking it would absorb the swing of the arm, which made
    paths of the IPIN logs two to four times worse.
    """
    vqf = import_extra("vqf", "dead reckoning", "odometry")
    settings = {
        "motionBiasEstEnabled": False, "restThGyr": config.rest_turning_deg, "restThAcc": config.rest_acceleration,
        "biasSigmaRest": config.rest_bias_sd_deg,
    }  # fmt: skip
    found = vqf.offlineVQF(
        np.ascontiguousarray(rate), np.ascontiguousarray(acceleration), None, 1 / config.rate, settings
    )
    return Rotation.from_quat(found["quat6D"], scalar_first=True)
