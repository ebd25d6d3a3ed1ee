# SPDX-License-Identifier: BSD-3-Clause
"""Dates with a time of day (ISO 8601) as seconds since 1970."""

import re
from datetime import UTC, datetime

from magmatch.data.tables.nanoseconds import SECOND, seconds_of

# Date, time of day, decimals of a second, offset from UTC. Python's own parser drops all decimals behind the sixth.
_DATE = re.compile(
    r"(\d{4}-\d\d-\d\d|\d{8})[T ](\d\d:?\d\d(?::?\d\d)?)(?:[.,](\d{1,12}))?\s*(Z|UTC|[-+]\d\d(?::?\d\d)?)?",
    re.IGNORECASE,
)


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
