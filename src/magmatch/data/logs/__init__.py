# SPDX-License-Identifier: BSD-3-Clause
"""Recorder logs: ROS 1 and ROS 2 bags and MCAP, read in pieces."""
