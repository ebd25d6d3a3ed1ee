# SPDX-License-Identifier: BSD-3-Clause
"""Poses from a file of their own: TUM or EuRoC, told by content."""

from pathlib import Path

from magmatch.data.formats.euroc import POSE_COLUMNS, read_euroc
from magmatch.data.formats.extrinsic import read_extrinsic
from magmatch.data.formats.format import SurveyFormat
from magmatch.data.formats.recording import Recording
from magmatch.data.formats.sniff import FileKind, sniff
from magmatch.data.tables.tum import read_tum
from magmatch.data.trajectory import Trajectory
from magmatch.data.units import METRE_PER_UNIT, TimeUnit
from magmatch.errors import DataFormatError
from magmatch.typing import Scalars, Vectors

# Files of poses; the reader of TUM says what is wrong with other tables.
TRAJECTORY_KINDS: tuple[FileKind, ...] = ("tum", "csv", "euroc")


def load_trajectory(path: str | Path, layout: SurveyFormat, time_unit: TimeUnit | None = None) -> Trajectory:
    """Read a trajectory file, in metres and seconds; times are in the layout's unit unless the file says its own."""
    kind = sniff(path)
    if kind not in TRAJECTORY_KINDS:
        message = f"is a {kind} file, expected a trajectory: TUM (t x y z qx qy qz qw), EuRoC or a table of these"
        raise DataFormatError(path, message)
    unit, metre = layout.length_unit, METRE_PER_UNIT[layout.length_unit]
    if kind == "euroc":
        table = read_euroc(path, POSE_COLUMNS, unit, recover=layout.recover)
    else:
        table = read_tum(path, unit, time_unit or layout.trajectory_time_unit, recover=layout.recover)
    return Trajectory.from_table(table).scaled(metre)


def with_poses(
    path: str | Path,
    times: Scalars,
    field: Vectors,
    layout: SurveyFormat,
    hint: str = "",
    trajectory: Trajectory | None = None,
) -> Recording:
    """Field samples (s; T) with poses: those given, else of the trajectory file that the layout names."""
    if trajectory is None:
        if layout.trajectory is None:
            message = "holds no positions (a phone records none in metres); they come from a trajectory: --trajectory"
            raise DataFormatError(path, f"{message} POSES.tum{hint}")
        trajectory = load_trajectory(layout.trajectory, layout)
    return Recording(
        path=Path(path),
        times=times,
        field=field,
        trajectory=trajectory,
        field_frame=layout.field_frame,
        poses_from=layout.trajectory,
    ).carried(None if layout.extrinsic is None else read_extrinsic(layout.extrinsic))
