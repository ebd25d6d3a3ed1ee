# SPDX-License-Identifier: BSD-3-Clause
"""Units that files come in, and orders of magnitude; everything inside the package is tesla and metre."""

from collections.abc import Mapping
from math import log, log10
from typing import Literal, TypeVar

from magmatch.errors import ConfigurationError

FieldUnit = Literal["T", "mT", "uT", "nT", "G", "mG"]
LengthUnit = Literal["m", "cm", "mm"]
TimeUnit = Literal["s", "ms", "us", "ns"]

TESLA_PER_UNIT: dict[FieldUnit, float] = {"T": 1.0, "mT": 1e-3, "uT": 1e-6, "nT": 1e-9, "G": 1e-4, "mG": 1e-7}
METRE_PER_UNIT: dict[LengthUnit, float] = {"m": 1.0, "cm": 1e-2, "mm": 1e-3}
UNITS_PER_SECOND: dict[TimeUnit, float] = {"s": 1.0, "ms": 1e3, "us": 1e6, "ns": 1e9}
# As powers of ten.
DIGITS_OF_SECOND: dict[TimeUnit, int] = {unit: round(log10(n)) for unit, n in UNITS_PER_SECOND.items()}

# The Earth's field is 22 to 67 uT at the surface (World Magnetic Model); indoors steel moves it by a factor of two
# or so, hence the wider window in which a median magnitude is ordinary.
EARTH_FIELD = 48e-6
ORDINARY_FIELD = (10e-6, 200e-6)
# s: the clocks of one device differ by no more, start and stop together by as much, and stamp no more out of order.
CLOCKS_APART = 1.0
# No time, position or field in any unit comes near it; its square is still a number.
DAMAGED = 1e12
# Bytes.
MEBI = 1 << 20
# Path over which standard deviations of odometry are stated, m.
STATED_OVER = 10.0


Unit = TypeVar("Unit", bound=str)


def size_of_unit(unit: Unit, known: Mapping[Unit, float], name: str) -> float:
    """Give a unit's entry in one of the tables above; of an unknown one the error lists those known."""
    if not isinstance(unit, str) or unit not in known:
        msg = f"{name}: expected one of {', '.join(known)}, got {unit!r}"
        raise ConfigurationError(msg)
    return known[unit]


def likely_field_unit(median_number: float) -> FieldUnit | None:
    """Give the unit in which a number would be an ordinary magnitude near the Earth's surface.

    Examples
    --------
    >>> likely_field_unit(48.0), likely_field_unit(480.0), likely_field_unit(1e9)
    ('uT', 'mG', None)
    """
    low, high = ORDINARY_FIELD
    fits: list[tuple[float, FieldUnit]] = [
        (abs(log(median_number * tesla / EARTH_FIELD)), unit)
        for unit, tesla in TESLA_PER_UNIT.items()
        if low <= median_number * tesla <= high
    ]
    return min(fits)[1] if fits else None


def unusual_size(median: float) -> str:
    """Say that a field's median magnitude (T) is not one near the Earth's surface; nothing if it is."""
    if ORDINARY_FIELD[0] <= median <= ORDINARY_FIELD[1]:
        return ""
    return f"the median field magnitude is {field_text(median)}, unusual on Earth (about 50 uT)"


def field_text(tesla: float) -> str:
    """Field strength to three digits, in a unit that a reader can picture.

    Examples
    --------
    >>> field_text(48.25e-6), field_text(48.0)
    ('48.2 uT', '48 T')
    """
    for unit in ("nT", "uT", "mT"):
        if abs(tesla) < 1000 * TESLA_PER_UNIT[unit]:
            return f"{tesla / TESLA_PER_UNIT[unit]:.3g} {unit}"
    return f"{tesla:.3g} T"
