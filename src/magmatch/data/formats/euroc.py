# SPDX-License-Identifier: BSD-3-Clause
"""EuRoC CSV: ``#timestamp [ns], ...`` above rows of numbers, whole nanoseconds first, quaternions wxyz."""

from dataclasses import replace
from pathlib import Path

import numpy as np

from magmatch.data.tables.nanoseconds import seconds_of
from magmatch.data.tables.table import Table, read_table
from magmatch.data.tables.text import text_blocks
from magmatch.data.trajectory import Trajectory
from magmatch.errors import DataFormatError
from magmatch.typing import Indices

POSE_COLUMNS = ("t", "x", "y", "z", "qw", "qx", "qy", "qz")
FIELD_COLUMNS = ("t", "bx", "by", "bz")


def read_euroc_trajectory(path: str | Path, *, recover: bool) -> Trajectory:
    """Read the poses of a ground truth or an estimate."""
    return Trajectory.from_table(_read(path, POSE_COLUMNS, recover=recover))


def read_euroc_field(path: str | Path, *, recover: bool) -> Table:
    """Read the rows of a magnetometer."""
    return _read(path, FIELD_COLUMNS, recover=recover)


def _read(path: str | Path, names: tuple[str, ...], *, recover: bool) -> Table:
    """Rows with their stamps as seconds, rounded once."""
    n_columns = _width(path)
    if n_columns < len(names):
        raise DataFormatError(path, f"expected rows of {', '.join(names)}; found {n_columns} cells")
    rest = tuple(f"column {k + 1}" for k in range(len(names), n_columns))
    table = read_table(path, names, (*names, *rest), recover=recover)
    table.require_increasing("t")
    stamps = _stamps(path, table)
    times = seconds_of(stamps.tolist())
    wrong = np.flatnonzero(np.diff(times) <= 0)
    if len(wrong):
        message = "time steps are shorter than float64 seconds can tell apart"
        raise DataFormatError(path, message, line=int(table.line_numbers[wrong[0] + 1]), column="t")
    return replace(table, columns=table.columns | {"t": times})


def _width(path: str | Path) -> int:
    """Cells of the first row."""
    for block in text_blocks(path):
        for line in block.lines:
            if line.strip() and not line.lstrip().startswith("#"):
                return len(line.rstrip(", \t").split(","))
    return 1


def _stamps(path: str | Path, table: Table) -> Indices:
    """First cells of all rows as whole numbers, which float64 cannot hold."""
    stamps, n = np.empty(len(table), dtype=np.int64), 0
    for block in text_blocks(path):
        stop = int(np.searchsorted(table.line_numbers, block.start + len(block.lines), side="right"))
        for line in table.line_numbers[n:stop].tolist():
            stamp = block.lines[line - block.start - 1].split(",")[0].strip()
            if not stamp.isdecimal() or len(stamp) > 19 or int(stamp) >= 2**63:
                message = f"expected whole nanoseconds, found {stamp[:40]!r}"
                raise DataFormatError(path, message, line=line, column="t")
            stamps[n] = int(stamp)
            n += 1
    return stamps
