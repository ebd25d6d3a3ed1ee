# SPDX-License-Identifier: BSD-3-Clause
"""Logs of phones: read them, find where they were carried by dead reckoning, and calibrate their magnetometers."""

from magmatch.data.formats.phones.phone_log import PhoneLog
from magmatch.data.formats.phones.read import read_phone_log
from magmatch.preparation.choose_magnetometer import prepare_either
from magmatch.preparation.odometry.config import DeadReckoningConfig
from magmatch.preparation.odometry.dead_reckon import Odometry, dead_reckon

__all__ = ["DeadReckoningConfig", "Odometry", "PhoneLog", "dead_reckon", "prepare_either", "read_phone_log"]
