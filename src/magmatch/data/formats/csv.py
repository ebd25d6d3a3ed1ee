# SPDX-License-Identifier: BSD-3-Clause
"""The survey CSV: header row, columns matched by name, units and frames settled once at the door."""

import logging
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np

from magmatch.data.formats.extrinsic import read_extrinsic
from magmatch.data.formats.format import SurveyFormat
from magmatch.data.formats.load_trajectory import with_poses
from magmatch.data.formats.recording import Recording
from magmatch.data.survey import Survey
from magmatch.data.survey_columns import FIELD_COLUMNS, FRAME_COLUMN, POSITION_COLUMNS, wanted_columns
from magmatch.data.tables.quaternions import QUATERNION, rotations_of
from magmatch.data.tables.table import Table, read_table
from magmatch.data.tables.text_rows import require_stated
from magmatch.data.units import METRE_PER_UNIT, TESLA_PER_UNIT, UNITS_PER_SECOND
from magmatch.errors import DataFormatError
from magmatch.typing import Points

logger = logging.getLogger(__name__)


def read_survey_csv(path: str | Path, layout: SurveyFormat) -> Survey:
    """Read a survey CSV into tesla, metre and the survey's frame."""
    stated = layout.column_names()
    known = wanted_columns(stated)
    table = read_table(path, known, recover=layout.recover, advise=_advice, texts=(FRAME_COLUMN,))
    require_stated(path, table.names, stated)
    return survey_of_table(table.renamed(known), layout)


def survey_of_table(table: Table, layout: SurveyFormat) -> Survey:
    """Turn a table of samples, from whatever format, into a survey."""
    table = replace(
        table, columns=table.columns | {k: -table.columns[k] for k in layout.reversed_columns() if table.has(k)}
    )
    if table.has("t") and layout.time_unit != "s":
        times = table.columns["t"] / UNITS_PER_SECOND[layout.time_unit]
        table = replace(table, columns=table.columns | {"t": times})
    if layout.trajectory is not None:
        survey = recording_of_table(table, layout).survey()
        return replace(survey, pose_sd=layout.pose_sd or 0.0)
    _require_own_poses(table)
    if layout.extrinsic is not None:
        table = _carried(table, layout)
    survey = Survey.from_table(table, layout.field_unit, layout.length_unit, layout.field_frame)
    return survey if layout.pose_sd is None else replace(survey, pose_sd=layout.pose_sd)


def _carried(table: Table, layout: SurveyFormat) -> Table:
    """Turn a table's poses, of the body that carries the sensor, into the sensor's own."""
    orientations, T_body_sensor = rotations_of(table), read_extrinsic(layout.extrinsic or "")
    if orientations is None:
        message = (
            "has no orientations (qx, qy, qz, qw), which --extrinsic needs: the sensor's mount turns with its body"
        )
        raise DataFormatError(table.path, message)
    lever = orientations.apply(np.asarray(T_body_sensor.translation)) / METRE_PER_UNIT[layout.length_unit]
    moved = [table.stack(*POSITION_COLUMNS) + lever, (orientations * T_body_sensor.rotation).as_quat()]
    return replace(
        table, columns=table.columns | dict(zip((*POSITION_COLUMNS, *QUATERNION), np.hstack(moved).T, strict=True))
    )


def recording_of_table(table: Table, layout: SurveyFormat) -> Recording:
    """Join field samples with the poses of a trajectory file."""
    table.require(["t", *FIELD_COLUMNS], "With a trajectory the samples need times on its clock")
    table.require_increasing("t")
    ignored = [name for name in (*POSITION_COLUMNS, *QUATERNION) if table.has(name)]
    if ignored:
        logger.warning(
            "%s: columns %s are ignored, poses come from %s", table.path, ", ".join(ignored), layout.trajectory
        )
    field = table.stack(*FIELD_COLUMNS) * TESLA_PER_UNIT[layout.field_unit]
    return with_poses(table.path, table.columns["t"], field, layout)


def read_points(path: str | Path, layout: SurveyFormat) -> Points:
    """Positions of any CSV with columns ``x, y, z``, in metres and in the file's order."""
    table = read_table(path, POSITION_COLUMNS)
    table.require(POSITION_COLUMNS)
    return table.stack(*POSITION_COLUMNS) * METRE_PER_UNIT[layout.length_unit]


def _require_own_poses(table: Table) -> None:
    """Raise DataFormatError, with advice, where columns of a survey are missing."""
    hint = _advice(table.names)
    if table.has("x", "y", *FIELD_COLUMNS):
        hint = "A survey on one height has a column z too; all 0 will do"
    elif table.has(*POSITION_COLUMNS):
        hint = f"All three components of the field are needed, its magnitude alone will not do. {hint}"
    elif table.has("t", *FIELD_COLUMNS) and not _is_global(table.names):
        hint = "A log without positions takes them from a TUM file: --trajectory POSES.tum"
    table.require([*POSITION_COLUMNS, *FIELD_COLUMNS], hint)


def _advice(names: Sequence[str]) -> str:
    """What to do about a table without the columns of a survey, from the names it has."""
    if _is_global(names):
        return "Degrees of latitude and longitude are no positions in metres: project them first (UTM, a local plane)"
    return "Where they have other names: --columns x=THEIRS,y=...,bx=..."


def _is_global(names: Sequence[str]) -> bool:
    """Whether a table holds places on the globe."""
    return any(name.startswith("lat") for name in names) and any(name.startswith("lon") for name in names)
