# SPDX-License-Identifier: BSD-3-Clause
"""Other numeric channels of a log, such as motor currents, that a disturbance of the field may follow."""

from pathlib import Path

import numpy as np

from magmatch.data.formats import csv, parquet
from magmatch.data.formats.format import SurveyFormat
from magmatch.data.formats.recording import MAX_CHANNELS, Channels, TimeSeries
from magmatch.data.formats.sniff import sniff
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
    read = {"csv": csv.read_other_columns, "parquet": parquet.read_other_columns}.get(sniff(path))
    if read is None:
        return {}
    times, columns = read(path, layout, MAX_CHANNELS)
    times = times if layout.rate is None else None
    return {name: TimeSeries(times, values) for name, values in columns.items()}
