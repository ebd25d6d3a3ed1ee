# SPDX-License-Identifier: BSD-3-Clause
"""Poses from a file of their own: TUM or EuRoC, told by content.

EuRoC: ``#timestamp [ns], ...`` above rows of numbers, whole nanoseconds first, quaternions wxyz.
"""

from pathlib import Path

import numpy as np

from magmatch.data.formats.extrinsic import read_extrinsic
from magmatch.data.formats.format import SurveyFormat
from magmatch.data.formats.recording import Recording
from magmatch.data.formats.sniff import FileKind, sniff
from magmatch.data.tables.ordered_table import read_ordered
from magmatch.data.tables.table import Table
from magmatch.data.tables.tum import TUM_COLUMNS
from magmatch.data.trajectory import Trajectory
from magmatch.data.units import METRE_PER_UNIT, LengthUnit, TimeUnit
from magmatch.errors import DataFormatError
from magmatch.typing import Scalars, Vectors

# Files of poses; the reader of TUM says what is wrong with other tables.
TRAJECTORY_KINDS: tuple[FileKind, ...] = ("tum", "csv", "euroc")
EUROC_POSES = ("t", "x", "y", "z", "qw", "qx", "qy", "qz")
EUROC_FIELD = ("t", "bx", "by", "bz")


def load_trajectory(path: str | Path, layout: SurveyFormat, time_unit: TimeUnit | None = None) -> Trajectory:
    """Read a trajectory file, in metres and seconds; times are in the layout's unit unless the file says its own."""
    kind = sniff(path)
    if kind not in TRAJECTORY_KINDS:
        message = f"is a {kind} file, expected a trajectory: TUM (t x y z qx qy qz qw), EuRoC or a table of these"
        raise DataFormatError(path, message)
    unit, metre = layout.length_unit, METRE_PER_UNIT[layout.length_unit]
    if kind == "euroc":
        table = read_euroc(path, EUROC_POSES, unit, recover=layout.recover)
    else:
        times = time_unit or layout.trajectory_time_unit
        table = read_ordered(path, TUM_COLUMNS, times, unit, recover=layout.recover)[0]
    return Trajectory.from_table(table).scaled(metre)


def with_poses(
    path: str | Path, times: Scalars, field: Vectors, layout: SurveyFormat, trajectory: Trajectory | None = None
) -> Recording:
    """Field samples (s; T) with poses: those given, else of the trajectory file that the layout names."""
    if trajectory is None:
        if layout.trajectory is None:
            message = "holds no positions (a phone records none in metres); they come from a trajectory: --trajectory"
            advice = "'magmatch odometry' makes one where a phone's log holds accelerometer and gyroscope"
            raise DataFormatError(path, f"{message} POSES.tum ({advice})")
        trajectory = load_trajectory(layout.trajectory, layout)
    return Recording(
        path=Path(path),
        times=times,
        field=field,
        trajectory=trajectory,
        field_frame=layout.field_frame,
        poses_from=layout.trajectory,
    ).carried(None if layout.extrinsic is None else read_extrinsic(layout.extrinsic))


def read_euroc(
    path: str | Path, order: tuple[str, ...], length_unit: LengthUnit = "m", lone: str = "", *, recover: bool
) -> Table:
    """Read rows in one of these orders, stamps as seconds: of nanoseconds, unless the header states another unit."""
    table, unit = read_ordered(path, order, "ns", length_unit, lone, recover=recover)
    if unit == "ns":
        stamps = table.columns["t"] * 1e9
        # A thousandth, since the products are rounded; stamps are 64-bit integers.
        wrong = np.flatnonzero((np.abs(stamps - np.rint(stamps)) > 1e-3) | (stamps < 0) | (stamps >= 2**63))
        if len(wrong):
            message = f"expected whole nanoseconds, found '{stamps[wrong[0]]:.15g}'; are they in s: timestamp [s]?"
            raise DataFormatError(path, message, line=int(table.line_numbers[wrong[0]]), column="t")
    return table
