# SPDX-License-Identifier: BSD-3-Clause
"""Which columns a table of a survey has, and what a survey is made of them: files, DataFrames and Datasets alike."""

import json
import logging
from collections.abc import Mapping
from typing import Any, Literal, get_args

import numpy as np

from magmatch.arguments import found
from magmatch.data.tables.frames import table_of_frame
from magmatch.data.tables.header_names import header_of
from magmatch.data.tables.quaternions import QUATERNION, rotations_of
from magmatch.data.tables.table import Table
from magmatch.data.units import (
    DIGITS_OF_SECOND,
    METRE_PER_UNIT,
    TESLA_PER_UNIT,
    UNITS_PER_SECOND,
    FieldUnit,
    LengthUnit,
    TimeUnit,
    size_of_unit,
)
from magmatch.errors import ConfigurationError, DataFormatError
from magmatch.typing import Scalars

logger = logging.getLogger(__name__)

POSITION_COLUMNS = ("x", "y", "z")
FIELD_COLUMNS = ("bx", "by", "bz")
# These say the same in every row, and are written where they are not the defaults.
FRAME_COLUMN, ACCURACY_COLUMN, DEFAULT_FRAME = "survey_frame", "pose_sd", "survey"
COLUMNS = ("t", *POSITION_COLUMNS, *FIELD_COLUMNS, *QUATERNION, ACCURACY_COLUMN)
# Metadata of Parquet files, and first comment of older CSV files: the same two as JSON.
SCHEMA = "magmatch.survey/1"
FieldFrame = Literal["survey", "sensor"]


def wanted_columns(theirs: Mapping[str, str]) -> dict[str, str]:
    """Our names of all columns of a survey by the file's, which are alike where none is stated."""
    return {**theirs, **{name: name for name in COLUMNS if name not in theirs.values()}}


def digits_of_times(known: Mapping[str, str], unit: TimeUnit) -> dict[str, int]:
    """Unit of the times among columns {theirs: ours}, as a power of ten, as `read_table` takes it."""
    return {theirs: DIGITS_OF_SECOND[unit] for theirs, ours in known.items() if ours == "t"}


def warn_of_unused_times(table: Table) -> None:
    """Say so where a table has no column of times, but one whose name says that it holds some."""
    for name in () if table.has("t") else table.names:
        if header_of([name]).names == ("t",):
            words = "%s: has no column t, and '%s' is left out; if it holds the times: --columns t=%s"
            logger.warning(words, table.path, name, name)


def survey_arguments(
    table: Table, field_unit: FieldUnit, length_unit: LengthUnit, field_frame: FieldFrame
) -> dict[str, Any]:
    """Arguments of `Survey`, by name: of a table's columns, times in s."""
    if field_frame not in get_args(FieldFrame):
        msg = f"field_frame: expected one of {', '.join(get_args(FieldFrame))}, got {found(field_frame)}"
        raise ConfigurationError(msg)
    tesla = size_of_unit(field_unit, TESLA_PER_UNIT, "field_unit")
    metre = size_of_unit(length_unit, METRE_PER_UNIT, "length_unit")
    table.require([*POSITION_COLUMNS, *FIELD_COLUMNS])
    if table.has("t"):
        table.require_increasing("t")
    orientations, field = rotations_of(table), table.stack(*FIELD_COLUMNS) * tesla
    if field_frame == "sensor":
        if orientations is None:
            message = "field_frame 'sensor' needs orientations: columns qx, qy, qz, qw, or a trajectory file"
            raise DataFormatError(table.path, message)
        field = orientations.apply(field)
    positions, times = table.stack(*POSITION_COLUMNS) * metre, table.columns.get("t")
    samples = {"positions": positions, "field": field, "times": times, "orientations": orientations}
    return {**samples, "name": table.path.name, **_about(table)}


def survey_table(df: Any, name: str, time_unit: TimeUnit, theirs: Mapping[str, str]) -> Table:
    """Table of a DataFrame's columns (``theirs``: {ours: theirs}), times in s."""
    per_second = size_of_unit(time_unit, UNITS_PER_SECOND, "time_unit")
    table = table_of_frame(df, name, COLUMNS, theirs, per_second, texts=(FRAME_COLUMN,))
    warn_of_unused_times(table)
    return table


def stated_columns(
    columns: dict[str, Scalars], n: int, frame: str, pose_sd: float
) -> tuple[dict[str, Scalars], dict[str, str]]:
    """Columns of a file, and those of words: frame and accuracy of n samples where they are not the defaults."""
    if pose_sd:
        columns = columns | {ACCURACY_COLUMN: np.full(n, pose_sd)}
    plain = frame.isprintable() and frame == frame.strip() and frame[:1] not in ('"', "")
    return columns, {} if frame == DEFAULT_FRAME else {FRAME_COLUMN: frame if plain else json.dumps(frame)}


def _about(table: Table) -> dict[str, Any]:
    """Frame and accuracy, where the file was written by `Survey.save`."""
    text = next((c.removeprefix(SCHEMA) for c in table.comments if c.startswith(SCHEMA)), "{}")
    named = table.texts.get(FRAME_COLUMN, "")
    try:
        about = json.loads(text)
        frame = named or str(about.get("frame", DEFAULT_FRAME))
        pose_sd = float(about.get("pose_sd", 0.0))
    except (ValueError, TypeError, AttributeError):
        pose_sd = -1.0
    if not 0 <= pose_sd < np.inf:
        message = (
            f'expected {SCHEMA} {{"frame": ..., "pose_sd": ...}} in its first comment, found {text.strip()[:60]}'
        )
        raise DataFormatError(table.path, message)
    stated = table.columns.get(ACCURACY_COLUMN, np.array([pose_sd]))
    if stated.min() < 0 or np.ptp(stated):
        message = f"expected one standard deviation in m for all rows, found {stated.min():g} to {stated.max():g}"
        raise DataFormatError(table.path, message, column=ACCURACY_COLUMN)
    try:
        return {"frame": str(json.loads(frame)) if frame.startswith('"') else frame, "pose_sd": float(stated[0])}
    except ValueError:
        raise DataFormatError(table.path, f"expected a name, found {frame[:60]!r}", column=FRAME_COLUMN) from None
