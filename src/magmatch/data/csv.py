# SPDX-License-Identifier: BSD-3-Clause
"""The survey CSV: header row, columns matched by name, units and frames settled once at the door."""

import logging
from dataclasses import replace
from pathlib import Path

import numpy as np

from magmatch.data.format import SurveyFormat
from magmatch.data.quaternions import QUATERNION
from magmatch.data.sniff import sniff
from magmatch.data.survey import COLUMNS, FIELD_COLUMNS, POSITION_COLUMNS, Survey
from magmatch.data.table import Table, read_table
from magmatch.data.trajectory import Trajectory
from magmatch.data.units import METRE_PER_UNIT, TESLA_PER_UNIT
from magmatch.errors import DataFormatError
from magmatch.typing import Points

logger = logging.getLogger(__name__)


def read_survey_csv(path: str | Path, layout: SurveyFormat) -> Survey:
    """Read a survey CSV into tesla, metre and the survey's frame.

    Parameters
    ----------
    path : path
        The file.
    layout : SurveyFormat
        Its units and frames.

    Returns
    -------
    Survey
        Not yet checked for plausibility; see `magmatch.data.checks.check_survey`.

    Raises
    ------
    DataFormatError
        With line and column wherever one is at fault.
    """
    table = read_table(path, COLUMNS)
    survey = _with_own_poses(table) if layout.trajectory is None else _with_poses_from(table, layout.trajectory)
    field = survey.field * TESLA_PER_UNIT[layout.field_unit]
    if layout.field_frame == "sensor":
        if survey.orientations is None:
            message = "field_frame 'sensor' needs orientations: columns qx, qy, qz, qw, or a trajectory file"
            raise DataFormatError(path, message)
        field = survey.orientations.apply(field)
    return replace(
        survey,
        positions=survey.positions * METRE_PER_UNIT[layout.length_unit],
        field=field,
        pose_sd=survey.pose_sd if layout.pose_sd is None else layout.pose_sd,
    )


def read_points(path: str | Path, layout: SurveyFormat | None = None) -> Points:
    """Read positions only, from any CSV with columns ``x, y, z``.

    Parameters
    ----------
    path : path
        The file; other columns are ignored.
    layout : SurveyFormat, optional
        Its length unit.

    Returns
    -------
    (n, 3) array, m
        Positions, in the file's order and frame.

    Raises
    ------
    DataFormatError
        With line and column wherever one is at fault.
    """
    table = read_table(path, POSITION_COLUMNS)
    table.require(POSITION_COLUMNS)
    return table.stack(*POSITION_COLUMNS) * METRE_PER_UNIT[(layout or SurveyFormat()).length_unit]


def _with_own_poses(table: Table) -> Survey:
    """Build the survey in the file's own units."""
    hint = ""
    if table.has("t", *FIELD_COLUMNS):
        hint = "A log without positions takes them from a TUM file: --trajectory POSES.tum"
    table.require([*POSITION_COLUMNS, *FIELD_COLUMNS], hint)
    return Survey.from_table(table)


def _with_poses_from(table: Table, trajectory_path: Path) -> Survey:
    """Field samples of a log at poses interpolated from a trajectory file; lengths in that file's unit."""
    table.require(["t", *FIELD_COLUMNS], "With a trajectory the samples need times on its clock")
    table.require_increasing("t")
    ignored = [name for name in (*POSITION_COLUMNS, *QUATERNION) if table.has(name)]
    if ignored:
        logger.warning(
            "%s: columns %s are ignored, poses come from %s", table.path, ", ".join(ignored), trajectory_path
        )
    kind = sniff(trajectory_path)
    if kind in {"map", "registration"}:
        raise DataFormatError(trajectory_path, f"is a saved {kind}, expected a TUM trajectory (t x y z qx qy qz qw)")
    trajectory = Trajectory.load(trajectory_path)
    times = table.columns["t"]
    is_covered = trajectory.covers(times)
    n_covered = int(is_covered.sum())
    if n_covered == 0:
        message = (
            f"no sample lies within the trajectory: the field covers {times[0]:.9g} to {times[-1]:.9g} s, "
            f"{trajectory_path} covers {trajectory.times[0]:.9g} to {trajectory.times[-1]:.9g} s; "
            "both need the same clock"
        )
        raise DataFormatError(table.path, message, column="t")
    if n_covered < len(times):
        n_dropped, n_before = len(times) - n_covered, int((times < trajectory.times[0]).sum())
        logger.warning(
            "%s: dropped %d of %d samples without a pose (%d before the trajectory begins, %d after it ends)",
            table.path, n_dropped, len(times), n_before, n_dropped - n_before,
        )  # fmt: skip
    kept = times[is_covered]
    _warn_of_pose_gaps(table.path, trajectory, kept)
    positions, orientations = trajectory.interpolate(kept)
    return Survey(positions, table.stack(*FIELD_COLUMNS)[is_covered], kept, orientations, name=table.path.name)


def _warn_of_pose_gaps(path: Path, trajectory: Trajectory, times: np.ndarray) -> None:
    """Say where poses are interpolated across a hole in the trajectory."""
    intervals = np.diff(trajectory.times)
    limit = max(1.0, 10 * float(np.median(intervals)))
    before = np.clip(np.searchsorted(trajectory.times, times, side="right") - 1, 0, len(intervals) - 1)
    n_in_gaps = int((intervals[before] > limit).sum())
    if n_in_gaps:
        logger.warning(
            "%s: %d samples lie in gaps of the trajectory longer than %.3g s; their poses are interpolated",
            path, n_in_gaps, limit,
        )  # fmt: skip
