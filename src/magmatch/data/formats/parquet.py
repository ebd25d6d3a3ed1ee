# SPDX-License-Identifier: BSD-3-Clause
"""Parquet tables of samples: the columns of the survey CSV, in binary."""

import json
import logging
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from magmatch.atomic import atomic_write
from magmatch.data.dataframes import NO_ROW_NUMBER
from magmatch.data.formats.format import SurveyFormat
from magmatch.data.survey import Survey
from magmatch.data.survey_columns import SCHEMA, choose_columns
from magmatch.data.tables.table import Table, table_of_columns
from magmatch.data.tables.text import plain_file, read_bytes
from magmatch.data.tables.times import seconds_of_column, seconds_of_dates
from magmatch.data.units import UNITS_PER_SECOND
from magmatch.errors import DataFormatError, MagmatchError, import_extra
from magmatch.typing import Scalars

logger = logging.getLogger(__name__)


def read_parquet(path: str | Path, layout: SurveyFormat) -> Table:
    """Read the columns of a survey from a Parquet file."""
    with _opened(path) as (file, pa):
        names = [str(name) for name in file.schema_arrow.names]
        chosen = choose_columns(path, names, layout.stated_columns(), has_poses=layout.trajectory is None)
        if "t" not in chosen.ours.values():
            chosen = replace(chosen, ours={**chosen.ours, **_index_of_dates(Path(path), file, pa)})
        wanted = {name: chosen.ours[name.lower()] for name in names if name.lower() in chosen.ours}
        for name in wanted:
            _require_numbers(Path(path), name, file.schema_arrow.field(name).type, pa)
        clock = next((name for name, ours in wanted.items() if ours == "t"), None)
        found = _columns(Path(path), file, list(wanted), pa, {clock: UNITS_PER_SECOND[layout.time_unit]})
        about = (file.schema_arrow.metadata or {}).get(SCHEMA.encode())
    comments = (f"{SCHEMA} {about.decode('utf-8', 'replace')}",) if about else ()
    columns = {name.lower(): values for name, values in found.items()}
    return replace(chosen.of(table_of_columns(path, columns, comments=comments)), names=tuple(names))


def _index_of_dates(path: Path, file: Any, pa: Any) -> dict[str, str]:
    """The times among what pandas calls an index without a name: increasing dates; of others a warning says so."""
    for name in file.schema_arrow.names:
        kind = file.schema_arrow.field(name).type
        if not name.startswith("__index_level_"):
            continue
        is_date, is_whole = pa.types.is_timestamp(kind), pa.types.is_integer(kind)
        values = _columns(path, file, [name], pa, {})[name] if is_date or is_whole else np.zeros(2)
        if is_date and (np.diff(values) > 0).all():
            return {name: "t"}
        if is_whole and np.abs(values).max() < NO_ROW_NUMBER:
            continue
        words = "%s: has no column t, and its index without a name is left out; if it holds the times: --columns t=%s"
        logger.warning(words, path, name)
    return {}


def read_other_columns(
    path: str | Path, layout: SurveyFormat, most: int
) -> tuple[Scalars | None, dict[str, Scalars]]:
    """Times in s, and the finite number columns that are none of a survey's."""
    columns: dict[str, Scalars] = {}
    with _opened(path) as (file, pa):
        schema, times = file.schema_arrow, None
        names, has_poses = [str(name) for name in schema.names], layout.trajectory is None
        known = choose_columns(path, names, layout.stated_columns(), has_poses=has_poses).ours
        for name in schema.names:
            ours = known.get(name.lower())
            if (ours is None and len(columns) == most) or ours not in (None, "t") or schema.names.count(name) > 1:
                continue
            try:
                _require_numbers(Path(path), name, schema.field(name).type, pa)
                per_second = {name: UNITS_PER_SECOND[layout.time_unit]} if ours == "t" else {}
                values = _columns(Path(path), file, [name], pa, per_second)[name]
            except DataFormatError:
                continue
            if ours == "t":
                times = values
            elif np.isfinite(values).all():
                columns[name] = values
    return times, columns


@contextmanager
def _opened(path: str | Path) -> Iterator[tuple[Any, Any]]:
    """The file and pyarrow; whatever is wrong with the file becomes one error."""
    pa, pq = (import_extra(name, "reading Parquet", "parquet") for name in ("pyarrow", "pyarrow.parquet"))
    read_bytes(path, 4)
    try:
        with plain_file(path) as place, pq.ParquetFile(place, pre_buffer=False) as file:
            yield file, pa
    except (pa.ArrowException, OSError, ValueError, KeyError, MemoryError) as error:
        if isinstance(error, MagmatchError):
            raise
        words = " ".join(str(error).split())[:150]
        raise DataFormatError(path, f"is a damaged Parquet file ({words})") from None


def _columns(
    path: Path, file: Any, names: list[str], pa: Any, per_second: Mapping[str | None, float]
) -> dict[str, Scalars]:
    """Some columns; numbers of one that `per_second` names become seconds."""
    table = file.read(columns=names, use_threads=False)
    if not table.num_rows:
        raise DataFormatError(path, "holds no rows")
    return {name: _numbers(table.column(name), pa, per_second.get(name, 1.0)) for name in names}


def _require_numbers(path: Path, name: str, kind: Any, pa: Any) -> None:
    is_number = pa.types.is_floating(kind) or pa.types.is_integer(kind) or pa.types.is_timestamp(kind)
    if not is_number:
        advice = "store it as float64, or as time stamps if it holds times"
        raise DataFormatError(path, f"expected a column of numbers, found {str(kind)[:60]}; {advice}", column=name)


def _numbers(column: Any, pa: Any, per_unit: float) -> Scalars:
    """A column as float64, NaN where it has none; numbers that count parts of a unit are divided, no stamps."""
    # NumPy stamps hold whole nanoseconds; Python's own stop at microseconds.
    values = column.to_numpy()
    return seconds_of_dates(values) if pa.types.is_timestamp(column.type) else seconds_of_column(values, per_unit)


def write_parquet(survey: Survey, path: str | Path) -> None:
    """Write a survey as Parquet, with the columns of the CSV; reading it back gives the same float64 values."""
    pa, pq = (import_extra(name, "writing Parquet", "parquet") for name in ("pyarrow", "pyarrow.parquet"))
    about = json.dumps({"frame": survey.frame, "pose_sd": float(survey.pose_sd)})
    table = pa.table(survey.columns()).replace_schema_metadata({SCHEMA: about})
    with atomic_write(path) as stream:
        pq.write_table(table, stream, compression="zstd")
