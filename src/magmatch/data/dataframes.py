# SPDX-License-Identifier: BSD-3-Clause
"""Tables of other libraries: a DataFrame (pandas, polars) or an xarray Dataset as a table of numbers."""

import logging
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from magmatch.arguments import column_of, expect_kind, found, require_finite
from magmatch.data.survey_columns import COLUMNS, FRAME_COLUMN, GLOBAL_COLUMNS, choose_columns, warn_of_unused_times
from magmatch.data.tables.table import Table
from magmatch.data.tables.times import seconds_of_column, seconds_of_dates
from magmatch.data.units import UNITS_PER_SECOND, TimeUnit, size_of_unit
from magmatch.errors import ConfigurationError, DataFormatError
from magmatch.typing import Scalars

logger = logging.getLogger(__name__)

# s since 1970, of the years 1998 to 2112. Smaller whole numbers may count rows, which no table in memory has as many
# of.
SINCE_1970 = (9e8, 4.5e9)


def table_of_frame(df: Any, name: str, time_unit: TimeUnit, theirs: Mapping[str, str]) -> Table:
    """Columns of a survey in a DataFrame (``theirs``: {ours: theirs}); rows by position, times in s."""
    per_second = size_of_unit(time_unit, UNITS_PER_SECOND, "time_unit")
    expect_kind(name, "name", (str,))
    _expect_names(theirs)
    if not hasattr(df, "columns") or not hasattr(df, "__getitem__"):
        msg = f"df: expected a DataFrame, got {found(df)}; Survey(positions, field) takes arrays"
        raise TypeError(msg)
    known = (*COLUMNS, *GLOBAL_COLUMNS)
    if unknown := [ours for ours in theirs if ours not in known]:
        msg = f"columns: expected pairs {{ours: theirs}} with ours of {', '.join(known)}, got '{unknown[0]}'"
        raise ConfigurationError(msg)
    # Of pandas: an index that is named as a column is one, such as the times.
    levels = set(getattr(getattr(df, "index", None), "names", ())) - set(df.columns) - {None}
    names = list(dict.fromkeys(str(column) for column in (*df.columns, *levels)))
    chosen = choose_columns(name, names, {ours: str(text).lower() for ours, text in theirs.items()})
    if any(str(level).lower() in chosen.ours for level in levels):
        df = df.reset_index(allow_duplicates=True)
    there = {str(column).lower(): column for column in df.columns}
    columns = {key: _numbers(df[there[key]], ours, name, len(df), per_second) for key, ours in chosen.ours.items()}
    frames = df[there[FRAME_COLUMN]] if FRAME_COLUMN in there else ()
    # A missing cell equals nothing, not even itself.
    words = {FRAME_COLUMN: ["" if w is None or w != w else str(w) for w in frames]}  # noqa: PLR0124
    table = chosen.of(Table(Path(name), tuple(map(str, df.columns)), columns, np.arange(1, len(df) + 1), (), words))
    index: Any = getattr(df, "index", None)
    unnamed = [index.get_level_values(k) for k in range(getattr(index, "nlevels", 0))]
    called = ("without a name" if level.name is None else f"'{level.name}'" for level in unnamed)
    said = [f"{one} is left out; if it holds the times, name it t" for one in called]
    if not table.has("t") and (k := level_of_dates(unnamed, said, name)) is not None:
        table.columns["t"] = _numbers(unnamed[k], "t", name, len(df), per_second)
    warn_of_unused_times(table)
    return table


def level_of_dates(levels: Sequence[Any], left_out: Sequence[str], path: str | Path) -> int | None:
    """Number of the index level, none named t, that holds increasing dates; warnings name others that may be."""
    for k, level in enumerate(levels):
        kind = getattr(level.dtype, "kind", "")
        if kind == "M" and (np.diff(seconds_of_dates(level)) > 0).all():
            return k
        if kind not in ("i", "u") or (len(level) and max(abs(level.min()), abs(level.max())) >= SINCE_1970[0]):
            logger.warning("%s: has no column t, and its index %s", path, left_out[k])
    return None


def frame_of_xarray(dataset: Any, theirs: Mapping[str, str]) -> tuple[Any, dict[str, str]]:
    """DataFrame of a Dataset's points, and the units that its variables state, by our names."""
    if not hasattr(dataset, "data_vars"):
        msg = f"dataset: expected an xarray Dataset, got {found(dataset)}; DataArray.to_dataset makes one"
        raise TypeError(msg)
    _expect_names(theirs)
    units: dict[str, str] = {}
    for group in (("x", "y", "z"), ("bx", "by", "bz"), ("t",)):
        there = (dataset.variables.get(theirs.get(ours, ours)) for ours in group)
        stated = {str(one.attrs["units"]) for one in there if one is not None and "units" in one.attrs}
        if len(stated) > 1:
            said = " and ".join(sorted(stated))
            msg = f"columns: expected one unit for {', '.join(group)}, got {said}; convert them first"
            raise ConfigurationError(msg)
        units |= dict.fromkeys(group, stated.pop()) if stated else {}
    return dataset.to_dataframe().reset_index(), units


def _expect_names(theirs: Any) -> None:
    expect_kind(theirs, "columns", (Mapping,), "give a dict of ours to theirs, such as {'x': 'east'}")


def _numbers(column: Any, ours: str, name: str, n: int, per_second: float) -> Scalars:
    """A column as finite float64; times as seconds, dates since 1970."""
    try:
        if np.ndim(column) == 2:
            msg = f"expected one column for {ours}, found {np.shape(column)[1]} of that name; drop the others"
            raise ValueError(msg)  # noqa: TRY301
        if ours == "t" and getattr(column.dtype, "kind", "") == "M":
            seconds = seconds_of_dates(column)
            require_finite(seconds, ours)
            return seconds
        values = column_of(column, ours, "any unit", n)
        if ours != "t":
            return values
        # Nullable columns of pandas are objects to NumPy, unless it is told.
        is_whole = getattr(getattr(column, "dtype", None), "kind", "") in ("i", "u")
        return seconds_of_column(np.asarray(column, dtype=np.int64 if is_whole else None), per_second)
    except ValueError as error:
        raise DataFormatError(name, str(error)) from None
