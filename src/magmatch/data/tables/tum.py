# SPDX-License-Identifier: BSD-3-Clause
"""TUM trajectories: rows ``t x y z qx qy qz qw`` without a header, separated by white space."""

from pathlib import Path

import numpy as np

from magmatch.atomic import atomic_write
from magmatch.data.tables.table import Table, read_table
from magmatch.typing import Points, Scalars

TUM_COLUMNS = ("t", "x", "y", "z", "qx", "qy", "qz", "qw")


def read_tum(path: str | Path) -> Table:
    """Read the rows of a TUM file.

    Parameters
    ----------
    path : path
        The file; lines that start with ``#`` are comments.

    Returns
    -------
    Table
        Columns ``t`` (s), ``x, y, z`` (m) and ``qx, qy, qz, qw``; times strictly increasing.

    Raises
    ------
    DataFormatError
        With the line at fault.
    """
    table = read_table(path, TUM_COLUMNS, TUM_COLUMNS)
    table.require_increasing("t")
    return table


def write_tum(path: str | Path, times: Scalars, positions: Points, quaternions: np.ndarray) -> None:
    """Write a trajectory in TUM layout.

    Parameters
    ----------
    path : path
        Where; replaced only once complete.
    times : (n,) array, s
    positions : (n, 3) array, m
    quaternions : (n, 4) array
        xyzw.
    """
    rows = np.column_stack([times, positions, quaternions]).tolist()
    lines = [f"# {' '.join(TUM_COLUMNS)}", *(" ".join(map(repr, row)) for row in rows), ""]
    with atomic_write(path) as stream:
        stream.write("\n".join(lines).encode())
