# SPDX-License-Identifier: BSD-3-Clause
"""The survey CSV: header row, columns matched by name, units and frames settled once at the door."""

import logging
import re
from collections.abc import Collection, Mapping, Sequence
from contextlib import suppress
from dataclasses import replace
from pathlib import Path

import numpy as np

from magmatch.data.formats.extrinsic import read_extrinsic
from magmatch.data.formats.format import SurveyFormat
from magmatch.data.formats.load_trajectory import with_poses
from magmatch.data.formats.recording import Recording
from magmatch.data.survey import Survey
from magmatch.data.survey_columns import (
    COLUMNS,
    FIELD_COLUMNS,
    FRAME_COLUMN,
    GLOBAL_COLUMNS,
    POSITION_COLUMNS,
    ChosenColumns,
    choose_columns,
    column_numbers,
    local_positions,
    position_columns,
    refuse_numbers_of_others,
    warn_of_unused_times,
)
from magmatch.data.tables.header_names import header_of, unit_of
from magmatch.data.tables.table import QUATERNION, Table, Wanted, read_table
from magmatch.data.tables.text import text_lines
from magmatch.data.tables.text_rows import is_sample
from magmatch.data.units import DIGITS_OF_SECOND, METRE_PER_UNIT, TESLA_PER_UNIT, UNITS_PER_SECOND
from magmatch.errors import ConfigurationError, DataFormatError
from magmatch.typing import Points, Scalars

logger = logging.getLogger(__name__)

UNITS: Mapping[str, Collection[str]] = {"time": UNITS_PER_SECOND, "length": METRE_PER_UNIT, "field": TESLA_PER_UNIT}


def read_survey_csv(path: str | Path, layout: SurveyFormat) -> Survey:
    """Read a survey CSV into tesla, metre and the survey's frame."""
    table, _ = read_columns(path, layout)
    if layout.rate is None:
        _warn_of_unnamed(table, layout)
    return survey_of_table(table, layout)


def _warn_of_unnamed(table: Table, layout: SurveyFormat) -> None:
    """Say that a column without a name is left out, unless it counts the rows: pandas so writes an index of times."""
    name = next((name for name in ("", "unnamed: 0") if name in table.names), None)
    if name is None or table.has("t"):
        return
    path = table.path
    try:
        values = _read_one(path, layout, table, name).columns[name]
        is_count = values[0] % 1 == 0 and bool((np.diff(values) == 1).all())
    except DataFormatError:
        is_count = False
    if not is_count:
        logger.warning("%s: a column without a name is left out; if it holds times, name it t in the header", path)


def read_columns(path: str | Path, layout: SurveyFormat) -> tuple[Table, ChosenColumns]:
    """Read the columns of a survey from a CSV, by our names; and which is which in the file."""
    stated, has_poses = layout.stated_columns(), layout.trajectory is None

    def choose(names: Sequence[str]) -> ChosenColumns:
        return choose_columns(path, names, stated, has_poses=has_poses)

    wanted = Wanted(
        (*stated.values(), *COLUMNS),
        words=(FRAME_COLUMN,),
        choose=lambda names: choose(names).ours,
        numbered=column_numbers(stated),
        decimal=layout.decimal or "",
        digits={"t": DIGITS_OF_SECOND[layout.time_unit]},
        recover=layout.recover,
        advise=advice_for,
    )
    table = read_table(path, wanted)
    refuse_numbers_of_others(path, table.header, stated)
    chosen = choose(table.names)
    _warn_of_units(path, {_word(theirs, table.header): ours for theirs, ours in chosen.ours.items()}, layout)
    return chosen.of(table), chosen


def _word(theirs: str, header: Sequence[str]) -> str:
    """What the header, if there is one, says of a column that is known by name or by number."""
    return header[int(theirs) - 1] if theirs.isdecimal() and 1 <= int(theirs) <= len(header) else theirs


def _warn_of_units(path: str | Path, ours_of: Mapping[str, str], layout: SurveyFormat) -> None:
    """Say so where the name of a column states another unit than the one that it is read in."""
    read_in: dict[str, str] = {"t": layout.time_unit} if layout.rate is None else {}
    read_in |= dict.fromkeys(POSITION_COLUMNS, layout.length_unit) | dict.fromkeys(FIELD_COLUMNS, layout.field_unit)
    for theirs, ours in ours_of.items():
        option = "time" if ours == "t" else "length" if ours in POSITION_COLUMNS else "field"
        stated = unit_of(theirs)
        if ours in read_in and stated in UNITS[option] and stated != read_in[ours]:
            words = "%s: column '%s' is read in %s: is that what its name means? (--%s-unit %s)"
            logger.warning(words, path, theirs, read_in[ours], option, stated)


def advice_for(names: Sequence[str]) -> str:
    """Advise about a table without the columns of a survey, from the names it has."""
    if names and all(map(is_sample, names)):
        pairs = "t=1,x=2,y=3,z=4,bx=5,by=6,bz=7" if len(names) > 6 else "t=1,bx=2,by=3,bz=4"
        pairs = "x=1,y=2,z=3,bx=4,by=5,bz=6" if len(names) == 6 else pairs
        return f"Without a header, number the columns from 1: --columns {pairs}"
    if len(names) == 1 and (mark := re.search(r"[^\w\s.()\[\]\"'/^-]", names[0])):
        return f"If '{mark[0]}' separates the columns, write sep={mark[0]} in a line above"
    if all(any(name.startswith(part) for name in names) for part in ("lat", "lon")):
        return "Where they have other names: --columns lat=THEIRS,lon=...,bx=..."
    return "Where they have other names: --columns x=THEIRS,y=...,bx=..."


def read_other_columns(
    path: str | Path, layout: SurveyFormat, most: int
) -> tuple[Scalars | None, dict[str, Scalars]]:
    """Times in s, and the number columns that are none of a survey's."""
    table, chosen = read_columns(path, layout)
    lines = text_lines(path)
    columns: dict[str, Scalars] = {}
    for name in table.names:
        if name in {*chosen.ours, *COLUMNS, ""} or table.names.count(name) > 1 or len(columns) == most:
            continue
        with suppress(DataFormatError):
            other = _read_one(path, layout, table, name, lines)
            is_there = np.isin(other.line_numbers, table.line_numbers)
            if is_there.sum() == len(table):
                columns[name] = other.columns[name][is_there]
    return table.columns.get("t"), columns


def _read_one(
    path: Path | str, layout: SurveyFormat, table: Table, name: str, lines: Sequence[str] | None = None
) -> Table:
    """Read one more column of a table, below the same header and with the same decimal mark."""
    numbered = column_numbers(layout.stated_columns())
    wanted = Wanted(
        (name,), numbered=numbered, decimal=table.decimal, recover=layout.recover, header_line=table.header_line
    )
    return read_table(path, wanted, lines)


def survey_of_table(table: Table, layout: SurveyFormat) -> Survey:
    """Turn a table of samples, from whatever format, into a survey; its times are in s."""
    table = _at_rate(table, layout)
    turned = {name: -table.columns[name] for name in layout.reversed_columns() if table.has(name)}
    table = replace(table, columns=table.columns | turned)
    warn_of_unused_times(table)
    if layout.trajectory is not None:
        survey = recording_of_table(table, layout).survey()
        return replace(survey, pose_sd=layout.pose_sd or 0.0)
    _require_own_poses(table)
    table = _carried(table, layout)
    survey = Survey.from_table(table, layout.field_unit, layout.length_unit, layout.field_frame, layout.origin)
    return survey if layout.pose_sd is None else replace(survey, pose_sd=layout.pose_sd)


def _carried(table: Table, layout: SurveyFormat) -> Table:
    """The table with the sensor's poses, where its own are those of a body that carries the sensor."""
    if layout.extrinsic is None:
        return table
    turns = table.rotations()
    if turns is None:
        message = "--extrinsic needs orientations, to tell where on the body the sensor is: columns qx, qy, qz, qw"
        raise DataFormatError(table.path, message)
    if not all(table.has(name) for name in POSITION_COLUMNS):
        message = "--extrinsic needs positions in metres, found latitude and longitude; magmatch convert writes them"
        raise DataFormatError(table.path, message)
    T_body_sensor = read_extrinsic(layout.extrinsic)
    lever = turns.apply(T_body_sensor.translation) / METRE_PER_UNIT[layout.length_unit]
    poses = np.hstack([table.stack(*POSITION_COLUMNS) + lever, (turns * T_body_sensor.rotation).as_quat()])
    names = (*POSITION_COLUMNS, *QUATERNION)
    return replace(table, columns=table.columns | dict(zip(names, poses.T, strict=True)))


def recording_of_table(table: Table, layout: SurveyFormat) -> Recording:
    """Join field samples with the poses of a trajectory file."""
    hint = table.advice
    if not table.has("t"):
        theirs = next((f": --columns t={name}" for name in table.names if header_of([name]).names == ("t",)), "")
        hint = "With a trajectory the samples need times on its clock" + (
            theirs if table.has(*FIELD_COLUMNS) else f". {hint}"
        )
    table.require(["t", *FIELD_COLUMNS], hint)
    table.require_increasing("t")
    ignored = [name for name in (*POSITION_COLUMNS, *GLOBAL_COLUMNS, *QUATERNION) if table.has(name)]
    if ignored:
        logger.warning(
            "%s: columns %s are ignored, poses come from %s", table.path, ", ".join(ignored), layout.trajectory
        )
    field = table.stack(*FIELD_COLUMNS) * TESLA_PER_UNIT[layout.field_unit]
    return with_poses(table.path, table.columns["t"], field, layout)


def read_points(path: str | Path, layout: SurveyFormat, height: float | None = None) -> Points:
    """Positions of any CSV with columns ``x, y, z``, in metres and in the file's order; or of places on the globe.

    Of these the layout must state the origin. The height (m) is advised where only z is missing.
    """

    def choose(names: Sequence[str]) -> Mapping[str, str]:
        own = (*POSITION_COLUMNS, *GLOBAL_COLUMNS) if layout.origin else POSITION_COLUMNS
        return {theirs: ours for theirs, ours in choose_columns(path, names, {}).ours.items() if ours in own}

    advice = "The points need a header row of these names, in metres (or --length-unit)"
    if layout.origin is None:
        advice += "; latitude and longitude are for maps about an origin"
    table = read_table(path, Wanted(POSITION_COLUMNS, choose=choose, advise=lambda _: advice))
    table = table.renamed(choose(table.names))
    names, metre = position_columns(table), METRE_PER_UNIT[layout.length_unit]
    hint = "" if height is None else f"The map keeps one height: add a column z of {height / metre:.4g}"
    table.require(names, hint if names == POSITION_COLUMNS and table.has("x", "y") else "")
    return (
        table.stack(*names) * metre if names == POSITION_COLUMNS else local_positions(table, metre, layout.origin)[0]
    )


def _at_rate(table: Table, layout: SurveyFormat) -> Table:
    """Give the samples times where a rate is stated; rows that were left out took their time too."""
    if layout.rate is None:
        return table
    if "t" in layout.stated_columns():
        msg = "--rate: expected a table without times; found a column stated for t: leave one of them out"
        raise ConfigurationError(msg)
    if table.has("t"):
        logger.warning("%s: column t is ignored, times come from the rate that is stated", table.path)
    rows = table.line_numbers - table.line_numbers[0] if layout.recover else np.arange(len(table))
    return replace(table, columns=table.columns | {"t": rows / layout.rate})


def _require_own_poses(table: Table) -> None:
    """Raise DataFormatError, with advice, where columns of a survey are missing."""
    names, hint = position_columns(table), table.advice
    missing = [name for name in names if not table.has(name)]
    if not missing:
        hint = f"All three components of the field are needed, its magnitude alone will not do. {hint}"
    elif table.has(*FIELD_COLUMNS) and missing in (["z"], ["alt"]):
        hint = "A survey on one height states it for all samples: --columns z=0.0"
    elif table.has("t", *FIELD_COLUMNS) and len(missing) == len(names):
        hint = f"A log without positions takes them from a TUM file: --trajectory POSES.tum. {hint}"
    table.require([*names, *FIELD_COLUMNS], hint)
