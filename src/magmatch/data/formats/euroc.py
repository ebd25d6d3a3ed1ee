# SPDX-License-Identifier: BSD-3-Clause
"""EuRoC CSV: ``#timestamp [ns], ...`` above rows of numbers, whole nanoseconds first, quaternions wxyz."""

from pathlib import Path

import numpy as np

from magmatch.data.tables.ordered_table import read_ordered
from magmatch.data.tables.table import Table
from magmatch.data.units import LengthUnit
from magmatch.errors import DataFormatError

POSE_COLUMNS = ("t", "x", "y", "z", "qw", "qx", "qy", "qz")
FIELD_COLUMNS = ("t", "bx", "by", "bz")


def read_euroc(
    path: str | Path, order: tuple[str, ...], length_unit: LengthUnit = "m", lone: str = "", *, recover: bool
) -> Table:
    """Read rows in one of these orders, stamps as seconds: of nanoseconds, unless the header states another unit."""
    table, unit = read_ordered(path, order, "ns", length_unit, lone, recover=recover)
    if unit == "ns":
        stamps = table.columns["t"] * 1e9
        # A thousandth, since the products are rounded; stamps are 64-bit integers.
        wrong = np.flatnonzero((np.abs(stamps - np.rint(stamps)) > 1e-3) | (stamps < 0) | (stamps >= 2**63))
        if len(wrong):
            message = f"expected whole nanoseconds, found '{stamps[wrong[0]]:.15g}'; are they in s: timestamp [s]?"
            raise DataFormatError(path, message, line=int(table.line_numbers[wrong[0]]), column="t")
    return table
