# SPDX-License-Identifier: BSD-3-Clause
"""Numbers as text: to the last bit in files, and with the digits that tell them apart in messages."""

from math import degrees, isfinite
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from numpy.typing import ArrayLike


def exact(numbers: "ArrayLike") -> list[str]:
    """Numbers (n,) of a text file, each as the shortest text that reads back as the same float64.

    Examples
    --------
    >>> exact([1700000005.144828, 0.1, 5334583.991234567])
    ['1700000005.144828', '0.1', '5334583.991234567']
    """
    import numpy as np  # messages need none of it, nor does help

    return list(map(repr, np.asarray(numbers).tolist()))


def told(number: float, digits: int = 15, step: float | None = None) -> str:
    """Number of a message, with so many significant digits, or more where a `step` (its unit) would be lost.

    Fifteen is what a float64 keeps of any decimal number: two times differ in print as they do in the file.

    Examples
    --------
    >>> told(1700000000.02), told(0.1 + 0.2), told(5334583.9912, 4, 1e-3), told(1.23456, 4, 1e-3)
    ('1700000000.02', '0.3', '5334583.991', '1.235')
    >>> told(1000.2, 3, 1.0)
    '1000'
    """
    if step is not None and isfinite(number) and abs(number) > step:
        digits = max(digits, len(str(round(abs(number) / step))))
    return f"{number:.{digits}g}"


def chance(probability: float) -> str:
    """A probability with three digits, never rounded to certainty.

    Examples
    --------
    >>> chance(0.0314), chance(1e-7), chance(1.0)
    ('0.031', 'below 0.001', 'above 0.999')
    """
    if probability < 0.001:
        return "below 0.001"
    return "above 0.999" if probability > 0.999 else f"{probability:.3f}"


def deviations(turn: float, shift: float) -> str:
    """Standard deviations of a rotation (rad) and a position (m), with two digits.

    Examples
    --------
    >>> deviations(0.001365, 0.00201), deviations(0.2, 1.234)
    ('0.078 deg, 2.0 mm', '11 deg, 1234 mm')
    """
    turn_text, shift_text = (f"{x:.0f}" if x >= 9.95 else f"{x:#.2g}" for x in (degrees(turn), 1e3 * shift))
    return f"{turn_text} deg, {shift_text} mm"


def many(n: int, what: str) -> str:
    """A count with its noun, whose plural ends in s.

    Examples
    --------
    >>> many(1, "gap"), many(2, "gap")
    ('1 gap', '2 gaps')
    """
    return f"{n} {what}" if n == 1 else f"{n} {what}s"
