# SPDX-License-Identifier: BSD-3-Clause
"""Poses from a file of their own: TUM or EuRoC, told by content."""

from collections.abc import Callable, Mapping
from pathlib import Path

from magmatch.data.formats.euroc import read_euroc_trajectory
from magmatch.data.formats.extrinsic import read_extrinsic
from magmatch.data.formats.format import SurveyFormat
from magmatch.data.formats.recording import Recording
from magmatch.data.formats.sniff import FileKind, sniff
from magmatch.data.tables.tum import read_tum
from magmatch.data.trajectory import Trajectory
from magmatch.data.units import METRE_PER_UNIT, LengthUnit
from magmatch.errors import DataFormatError
from magmatch.typing import Scalars, Vectors


def _read_tum(path: str | Path, length_unit: LengthUnit) -> Trajectory:
    return Trajectory.from_table(read_tum(path, length_unit))


TRAJECTORY_READERS: Mapping[FileKind, Callable[[str | Path, LengthUnit], Trajectory]] = {
    "tum": _read_tum,
    "csv": _read_tum,
    "euroc": read_euroc_trajectory,
}


def load_trajectory(path: str | Path, layout: SurveyFormat) -> Trajectory:
    """Read a trajectory file, in metres."""
    kind = sniff(path)
    if kind not in TRAJECTORY_READERS:
        message = f"is a {kind} file, expected a trajectory: TUM (t x y z qx qy qz qw), EuRoC or a table of these"
        raise DataFormatError(path, message)
    return TRAJECTORY_READERS[kind](path, layout.length_unit).scaled(METRE_PER_UNIT[layout.length_unit])


def with_poses(path: str | Path, times: Scalars, field: Vectors, layout: SurveyFormat, hint: str = "") -> Recording:
    """Field samples (s; T) with the poses of the trajectory file that the layout names."""
    if layout.trajectory is None:
        message = "holds no positions (a phone records none in metres); they come from a trajectory: --trajectory"
        raise DataFormatError(path, f"{message} POSES.tum{hint}")
    return Recording(
        path=Path(path),
        times=times,
        field=field,
        trajectory=load_trajectory(layout.trajectory, layout),
        field_frame=layout.field_frame,
        poses_from=layout.trajectory,
    ).carried(None if layout.extrinsic is None else read_extrinsic(layout.extrinsic))
