# SPDX-License-Identifier: BSD-3-Clause
"""Other number columns of a log, such as motor currents: read where they are there, skipped where they are text."""

from dataclasses import dataclass
from pathlib import Path

import numpy as np

from magmatch.data.survey import COLUMNS
from magmatch.data.table import read_table
from magmatch.errors import DataFormatError
from magmatch.typing import Scalars


@dataclass(frozen=True, eq=False, slots=True)
class Channels:
    """Columns beside the survey's own.

    Attributes
    ----------
    times : (n,) array, s, optional
        Of the rows.
    columns : dict of str to (n,) array
        In the file's own units.
    """

    times: Scalars | None
    columns: dict[str, Scalars]

    def at(self, times: Scalars | None, n: int) -> dict[str, Scalars]:
        """Values for the samples of a survey: by time where there is one, else row by row.

        Parameters
        ----------
        times : (n,) array, s, optional
            Of the survey, on the file's clock.
        n : int
            Number of its samples.

        Returns
        -------
        dict of str to (n,) array
            Empty where rows and samples cannot be matched.
        """
        if times is not None and self.times is not None:
            return {name: np.interp(times, self.times, values) for name, values in self.columns.items()}
        return {name: values for name, values in self.columns.items() if len(values) == n}


def read_channels(path: str | Path) -> Channels:
    """Read the number columns of a CSV that are none of a survey's.

    Parameters
    ----------
    path : path
        A survey CSV.

    Returns
    -------
    Channels
        Columns that hold anything but finite numbers are left out.

    Raises
    ------
    DataFormatError
        The file is no table at all.
    """
    table = read_table(path, COLUMNS)
    columns: dict[str, Scalars] = {}
    for name in table.names:
        if name in COLUMNS or not name or table.names.count(name) > 1:
            continue
        try:
            columns[name] = read_table(path, (name,)).columns[name]
        except DataFormatError:
            continue
    return Channels(table.columns.get("t"), columns)
