# SPDX-License-Identifier: BSD-3-Clause
"""Stamps: nanoseconds (or ms, us) in logs and tables, float64 seconds inside, rounded once each way."""

from collections.abc import Iterable

import numpy as np

from magmatch.data.tables.number_marks import Decimal, python_text
from magmatch.typing import Indices, Scalars

SECOND = 1_000_000_000
LARGEST_WHOLE = 2**53  # float64 holds all whole numbers below


def seconds_of(nanoseconds: Iterable[float], per_second: int = SECOND) -> Scalars:
    """Whole nanoseconds (or other parts of a second) as the nearest float64 seconds, as a reader of decimals rounds.

    Examples
    --------
    >>> seconds_of([1700000000123456789]).tolist() == [1700000000.123456789]
    True
    """
    # Python divides whole numbers exactly; NumPy would round twice.
    return np.array([stamp / per_second for stamp in nanoseconds], dtype=np.float64)


def seconds_of_column(values: np.ndarray, per_second: float) -> Scalars:
    """Numbers of any type as float64 seconds; whole ones are rounded once."""
    if per_second != 1 and values.dtype.kind in "iu" and values.dtype.itemsize == 8:
        return seconds_of(values.tolist(), int(per_second))
    seconds: Scalars = values.astype(np.float64) / per_second
    return seconds


def seconds_of_text(cell: str, digits: int, decimal: Decimal = "point") -> float:
    """A number in units of 10**-digits s as the nearest float64 seconds.

    Examples
    --------
    >>> seconds_of_text("1700000000123456789", 9), seconds_of_text("1.5e3", 3)
    (1700000000.1234567, 1.5)
    """
    if cell.isdecimal():
        return int(cell) / int(10**digits)  # which Python rounds once
    mantissa, _, exponent = python_text(cell, decimal).lower().partition("e")
    return float(f"{mantissa}e{int(exponent or 0) - digits}")


def nanoseconds_of(seconds: Scalars) -> Indices:
    """Seconds as the nearest whole nanoseconds."""
    whole = np.floor(seconds)
    stamps: Indices = whole.astype(np.int64) * SECOND + np.rint((seconds - whole) * SECOND).astype(np.int64)
    return stamps
