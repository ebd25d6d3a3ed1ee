# SPDX-License-Identifier: BSD-3-Clause
"""Times: dates, or stamps in nanoseconds (or ms, us), in files; float64 seconds inside, rounded once each way."""

import re
from collections.abc import Iterable
from datetime import UTC, datetime
from typing import Any

import numpy as np

from magmatch.data.tables.number_marks import Decimal, python_text
from magmatch.data.units import UNITS_PER_SECOND
from magmatch.typing import Indices, Scalars

# Date, time of day, decimals of a second, offset from UTC. Python's own parser drops all decimals behind the sixth.
_DATE = re.compile(
    r"(\d{4}-\d\d-\d\d|\d{8})[T ](\d\d:?\d\d(?::?\d\d)?)(?:[.,](\d{1,12}))?\s*(Z|UTC|[-+]\d\d(?::?\d\d)?)?",
    re.IGNORECASE,
)
SECOND = int(UNITS_PER_SECOND["ns"])


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
    return values.astype(np.float64) / per_second


def seconds_of_dates(dates: Any) -> Scalars:
    """Seconds since 1970 of dates that NumPy knows; NaN where one is missing."""
    stamps = np.asarray(dates).astype("datetime64[ns]")
    return np.where(np.isnat(stamps), np.nan, seconds_of(stamps.astype(np.int64).tolist()))


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
    return np.asarray(whole.astype(np.int64) * SECOND + np.rint((seconds - whole) * SECOND).astype(np.int64))


def seconds_of_date(text: str) -> float | None:
    """Seconds since 1970 of a date, to the nanosecond before they are rounded once; None if it is none.

    A date without an offset is taken as one in UTC.

    Examples
    --------
    >>> seconds_of_date("2024-05-01T10:00:00.25+02:00"), seconds_of_date("2024-05-01 08:00:00.25")
    (1714550400.25, 1714550400.25)
    """
    found = _DATE.fullmatch(text.strip().strip("'\""))
    if found is None:
        return None
    date, clock, decimals, offset = found.groups()
    offset = "" if offset is None or offset.upper() in {"Z", "UTC"} else offset
    try:
        moment = datetime.fromisoformat(f"{date}T{clock}{offset}")
    except ValueError:  # such as a thirteenth month
        return None
    whole = int((moment if offset else moment.replace(tzinfo=UTC)).timestamp())
    return float(seconds_of([whole * SECOND + int((decimals or "").ljust(9, "0")[:9])])[0])
