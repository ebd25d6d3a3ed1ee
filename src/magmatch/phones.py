# SPDX-License-Identifier: BSD-3-Clause
"""Logs of phones: read them, find where they were carried by dead reckoning, and calibrate their magnetometers."""

from magmatch.data.formats.phones.phone_log import PhoneLog
from magmatch.data.formats.phones.read import read_phone_log
from magmatch.data.surveyed_points import SurveyedPoints
from magmatch.preparation.odometry.dead_reckon import DeadReckoningConfig, Odometry, dead_reckon
from magmatch.preparation.odometry.open_walk import open_walk
from magmatch.preparation.prepare import prepare_either

__all__ = [
    "DeadReckoningConfig",
    "Odometry",
    "PhoneLog",
    "SurveyedPoints",
    "dead_reckon",
    "open_walk",
    "prepare_either",
    "read_phone_log",
]
