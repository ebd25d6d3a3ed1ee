# SPDX-License-Identifier: BSD-3-Clause
"""Other numeric channels of a log, such as motor currents, that a disturbance of the field may follow."""

from pathlib import Path

import numpy as np

from magmatch.data.formats.csv import read_columns
from magmatch.data.formats.format import SurveyFormat
from magmatch.data.formats.parquet import read_other_columns
from magmatch.data.formats.recording import MAX_CHANNELS, Channels, TimeSeries
from magmatch.data.formats.sniff import sniff
from magmatch.data.survey_columns import COLUMNS, column_numbers
from magmatch.data.tables.table import Wanted, read_table
from magmatch.data.tables.text import text_lines
from magmatch.errors import DataFormatError
from magmatch.typing import Scalars


def channels_at(channels: Channels, times: Scalars | None, n: int) -> dict[str, Scalars]:
    """Values for the samples of a survey: by time where there is one, else row by row."""
    found = {}
    for name, channel in channels.items():
        if times is not None and channel.times is not None:
            found[name] = np.interp(times, channel.times, channel.values)
        elif len(channel.values) == n:
            found[name] = channel.values
    return found


def read_channels(path: str | Path, layout: SurveyFormat) -> Channels:
    """Read the number columns of a table that are none of a survey's."""
    kind = sniff(path)
    if kind == "csv":
        times, columns = _of_csv(path, layout)
    elif kind == "parquet":
        times, columns = read_other_columns(path, layout, MAX_CHANNELS)
    else:
        return {}
    times = times if layout.rate is None else None
    return {name: TimeSeries(times, values) for name, values in columns.items()}


def _of_csv(path: str | Path, layout: SurveyFormat) -> tuple[Scalars | None, dict[str, Scalars]]:
    """Times in s, and the other columns."""
    table, chosen = read_columns(path, layout)
    own, numbered = {*chosen.ours, *COLUMNS}, column_numbers(layout.stated_columns())
    lines = text_lines(path)
    columns: dict[str, Scalars] = {}
    for name in table.names:
        if name in own or not name or table.names.count(name) > 1 or len(columns) == MAX_CHANNELS:
            continue
        try:
            wanted = Wanted(
                (name,),
                numbered=numbered,
                decimal=table.decimal,
                recover=layout.recover,
                header_line=table.header_line,
            )
            other = read_table(path, wanted, lines)
        except DataFormatError:
            continue
        is_there = np.isin(other.line_numbers, table.line_numbers)
        if is_there.sum() == len(table):
            columns[name] = other.columns[name][is_there]
    return chosen.of(table).columns.get("t"), columns
