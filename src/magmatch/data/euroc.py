# SPDX-License-Identifier: BSD-3-Clause
"""EuRoC CSV: ``#timestamp [ns], ...`` above rows of numbers, whole nanoseconds first, quaternions wxyz."""

from pathlib import Path

import numpy as np

from magmatch.data.nanoseconds import seconds_of
from magmatch.data.quaternions import rotations_of
from magmatch.data.table import Table, read_bytes, read_table, text_lines
from magmatch.data.trajectory import Trajectory
from magmatch.errors import DataFormatError

POSE_COLUMNS = ("t", "x", "y", "z", "qw", "qx", "qy", "qz")
FIELD_COLUMNS = ("t", "bx", "by", "bz")


def read_euroc_trajectory(path: str | Path) -> Trajectory:
    """Read the poses of a ground truth or an estimate.

    Parameters
    ----------
    path : path
        Rows ``timestamp, x, y, z, qw, qx, qy, qz`` and whatever follows (velocities, biases).

    Returns
    -------
    Trajectory

    Raises
    ------
    DataFormatError
        With the line at fault.
    """
    table = _read(path, POSE_COLUMNS)
    orientations = rotations_of(table)
    if orientations is None or len(table) < 2:
        raise DataFormatError(path, f"expected at least two poses, found {len(table)}")
    return Trajectory(table.columns["t"], table.stack("x", "y", "z"), orientations)


def read_euroc_field(path: str | Path) -> Table:
    """Read the rows of a magnetometer.

    Parameters
    ----------
    path : path
        Rows ``timestamp, bx, by, bz``; more columns are ignored.

    Returns
    -------
    Table
        Columns ``t`` (s) and ``bx, by, bz`` (in the file's unit).

    Raises
    ------
    DataFormatError
        With the line at fault.
    """
    return _read(path, FIELD_COLUMNS)


def _read(path: str | Path, names: tuple[str, ...]) -> Table:
    """Rows with their stamps as seconds, rounded once."""
    lines = text_lines(path, read_bytes(path))
    first = next((line for line in lines if line.strip() and not line.lstrip().startswith("#")), "")
    n_columns = len(first.rstrip(", \t").split(","))
    if n_columns < len(names):
        raise DataFormatError(path, f"expected rows of {', '.join(names)}; found {n_columns} cells")
    rest = tuple(f"column {k + 1}" for k in range(len(names), n_columns))
    table = read_table(path, names, (*names, *rest))
    table.require_increasing("t")
    numbers = set(table.line_numbers.tolist())
    stamps = [line.split(",")[0].strip() for i, line in enumerate(lines, 1) if i in numbers]
    for line, stamp in zip(table.line_numbers.tolist(), stamps, strict=True):
        if not stamp.isdecimal() or len(stamp) > 19:
            message = f"expected whole nanoseconds, found {stamp[:40]!r}"
            raise DataFormatError(path, message, line=line, column="t")
    times = seconds_of([int(stamp) for stamp in stamps])
    wrong = np.flatnonzero(np.diff(times) <= 0)
    if len(wrong):
        message = "time steps are shorter than float64 seconds can tell apart"
        raise DataFormatError(path, message, line=int(table.line_numbers[wrong[0] + 1]), column="t")
    return Table(table.path, table.names, table.columns | {"t": times}, table.line_numbers, table.comments)
