# SPDX-License-Identifier: BSD-3-Clause
"""Parquet tables of samples: the columns of the survey CSV, in binary."""

import json
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from magmatch.atomic import atomic_write
from magmatch.data.dataframes import level_of_dates
from magmatch.data.formats.csv import advice_for
from magmatch.data.formats.format import SurveyFormat
from magmatch.data.survey import Survey
from magmatch.data.survey_columns import SCHEMA, choose_columns
from magmatch.data.tables.table import Table, table_of_columns
from magmatch.data.tables.text import damage_told, plain_file, read_bytes
from magmatch.data.tables.times import seconds_of_column, seconds_of_dates
from magmatch.data.units import UNITS_PER_SECOND
from magmatch.errors import DataFormatError, import_extra
from magmatch.typing import Scalars


def read_parquet(path: str | Path, layout: SurveyFormat) -> Table:
    """Read the columns of a survey from a Parquet file."""
    with _opened(path) as file:
        names = [str(name) for name in file.schema_arrow.names]
        chosen = choose_columns(path, names, layout.stated_columns(), has_poses=layout.trajectory is None)
        if "t" not in chosen.ours.values():
            chosen = replace(chosen, ours={**chosen.ours, **_index_of_dates(path, file)})
        if not file.metadata.num_rows:
            raise DataFormatError(path, "holds no rows")
        columns = {
            name.lower(): _column(path, file, name, layout if chosen.ours[name.lower()] == "t" else None)
            for name in names
            if name.lower() in chosen.ours
        }
        about = (file.schema_arrow.metadata or {}).get(SCHEMA.encode())
    comments = (f"{SCHEMA} {about.decode('utf-8', 'replace')}",) if about else ()
    table = table_of_columns(path, columns, recover=layout.recover, comments=comments)
    return replace(chosen.of(table), names=tuple(names), advice=advice_for(names))


def _index_of_dates(path: str | Path, file: Any) -> dict[str, str]:
    """The times among what pandas calls an index without a name: increasing dates."""
    names = [name for name in file.schema_arrow.names if name.startswith("__index_level_")]
    levels = [file.read(columns=[name], use_threads=False).column(name).to_numpy() for name in names]
    left_out = [f"without a name is left out; if it holds the times: --columns t={name}" for name in names]
    k = level_of_dates(levels, left_out, path)
    return {} if k is None else {names[k]: "t"}


def read_other_columns(
    path: str | Path, layout: SurveyFormat, most: int
) -> tuple[Scalars | None, dict[str, Scalars]]:
    """Times in s, and the finite number columns that are none of a survey's."""
    columns: dict[str, Scalars] = {}
    times = None
    with _opened(path) as file:
        names = [str(name) for name in file.schema_arrow.names]
        known = choose_columns(path, names, layout.stated_columns(), has_poses=layout.trajectory is None).ours
        for name in names:
            ours = known.get(name.lower())
            if (ours is None and len(columns) == most) or ours not in (None, "t") or names.count(name) > 1:
                continue
            with suppress(DataFormatError):
                values = _column(path, file, name, layout if ours == "t" else None)
                if ours == "t":
                    times = values
                elif np.isfinite(values).all():
                    columns[name] = values
    return times, columns


@contextmanager
def _opened(path: str | Path) -> Iterator[Any]:
    """The file; whatever is wrong with it becomes one error."""
    pq = import_extra("pyarrow.parquet", "reading Parquet", "parquet")
    read_bytes(path, 4)
    with (
        damage_told(path, "Parquet file"),
        plain_file(path) as place,
        pq.ParquetFile(place, pre_buffer=False) as file,
    ):
        yield file


def _column(path: str | Path, file: Any, name: str, clock: SurveyFormat | None = None) -> Scalars:
    """A column as float64, NaN where it has none; that of a clock in s, whose numbers count the layout's unit."""
    from pyarrow import types

    kind = file.schema_arrow.field(name).type
    if not (types.is_floating(kind) or types.is_integer(kind) or types.is_timestamp(kind)):
        advice = "store it as float64, or as time stamps if it holds times"
        raise DataFormatError(path, f"expected a column of numbers, found {str(kind)[:60]}; {advice}", column=name)
    # NumPy stamps hold whole nanoseconds; Python's own stop at microseconds.
    values = file.read(columns=[name], use_threads=False).column(name).to_numpy()
    per_unit = 1.0 if clock is None else UNITS_PER_SECOND[clock.time_unit]
    return seconds_of_dates(values) if types.is_timestamp(kind) else seconds_of_column(values, per_unit)


def write_parquet(survey: Survey, path: str | Path) -> None:
    """Write a survey as Parquet, with the columns of the CSV; reading it back gives the same float64 values."""
    pa, pq = (import_extra(name, "writing Parquet", "parquet") for name in ("pyarrow", "pyarrow.parquet"))
    about = json.dumps({"frame": survey.frame, "pose_sd": float(survey.pose_sd)})
    table = pa.table(survey.columns()).replace_schema_metadata({SCHEMA: about})
    with atomic_write(path) as stream:
        pq.write_table(table, stream, compression="zstd")
