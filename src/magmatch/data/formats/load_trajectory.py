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
from magmatch.data.units import METRE_PER_UNIT, UNITS_PER_SECOND, TimeUnit
from magmatch.errors import DataFormatError
from magmatch.typing import Scalars, Vectors


def _read_tum(path: str | Path, *, recover: bool) -> Trajectory:
    return Trajectory.from_table(read_tum(path, recover=recover))


TRAJECTORY_READERS: Mapping[FileKind, Callable[..., Trajectory]] = {
    "tum": _read_tum,
    "csv": _read_tum,  # whose error says what a TUM file looks like
    "euroc": read_euroc_trajectory,
}


def load_trajectory(path: str | Path, layout: SurveyFormat, time_unit: TimeUnit | None = None) -> Trajectory:
    """Read a trajectory file, in metres and seconds; times of a TUM file are in the layout's unit unless stated."""
    kind = sniff(path)
    if kind not in TRAJECTORY_READERS:
        message = f"is a {kind} file, expected a trajectory: TUM (t x y z qx qy qz qw) or EuRoC"
        raise DataFormatError(path, message)
    # EuRoC files state nanoseconds themselves.
    unit = "s" if kind == "euroc" else time_unit or layout.trajectory_time_unit
    read = TRAJECTORY_READERS[kind](path, recover=layout.recover)
    return read.scaled(METRE_PER_UNIT[layout.length_unit], UNITS_PER_SECOND[unit])


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
