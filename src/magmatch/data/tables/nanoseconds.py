# SPDX-License-Identifier: BSD-3-Clause
"""Stamps: whole nanoseconds in logs, float64 seconds inside, rounded once each way."""

from collections.abc import Iterable

import numpy as np

from magmatch.typing import Indices, Scalars

SECOND = 1_000_000_000


def seconds_of(nanoseconds: Iterable[int]) -> Scalars:
    """Whole nanoseconds as the nearest float64 seconds, as a reader of decimals would round them.

    Examples
    --------
    >>> seconds_of([1700000000123456789]).tolist() == [1700000000.123456789]
    True
    """
    # Python divides whole numbers exactly; NumPy would round twice.
    return np.array([stamp / SECOND for stamp in nanoseconds], dtype=np.float64)


def nanoseconds_of(seconds: Scalars) -> Indices:
    """Seconds as the nearest whole nanoseconds."""
    whole = np.floor(seconds)
    stamps: Indices = whole.astype(np.int64) * SECOND + np.rint((seconds - whole) * SECOND).astype(np.int64)
    return stamps
