# SPDX-License-Identifier: BSD-3-Clause
"""Marks within numbers: whether a table's commas or points are decimal is decided by all of its numbers together."""

import re
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field
from typing import Literal

Decimal = Literal["point", "comma"]
# Signs that word processors and spreadsheets write for a minus: U+2212, hyphens, dashes.
_MINUS = str.maketrans(dict.fromkeys("\u2212\u2010\u2011\u2012\u2013\u2014\ufe63\uff0d", "-"))
_MARKS: dict[Decimal, str] = {"point": ".", "comma": ","}


def _pattern(mark: str, other: str) -> re.Pattern[str]:
    """Numbers with this decimal mark; groups of three digits are parted by one sign, the other mark among them."""
    grouped = (
        rf"[1-9]\d{{0,2}}(?P<group>[{other}' \u2019\u00a0\u2009\u202f])\d{{3}}(?:(?P=group)\d{{3}})*(?:{mark}\d*)?"
    )
    plain = rf"(?:\d+(?:{mark}\d*)?|{mark}\d+)(?:[eE][+-]?\d+)?"
    return re.compile(rf"[+-]?(?:{grouped}|{plain})", re.ASCII)


_PATTERNS: dict[Decimal, re.Pattern[str]] = {"point": _pattern(r"\.", ","), "comma": _pattern(",", r"\.")}
# Rows that are looked at where only points stand: whoever marks thousands by them shows it within so many.
MOST_POINTS = 10_000
# A whole number that has no groups.
_SHORT = re.compile(r"[+-]?[1-9]\d{0,2}", re.ASCII)


def plain_text(cell: str) -> str:
    """A cell without blanks around it, its minus the ASCII one."""
    return cell.strip().translate(_MINUS)


def python_text(cell: str, decimal: Decimal = "point") -> str:
    """A number as Python writes it, where the cell holds one; `ValueError` where its decimal mark is another."""
    text = plain_text(cell)
    if found := _PATTERNS[decimal].fullmatch(text):
        return text.replace(found["group"] or " ", "").replace(_MARKS[decimal], ".")
    if decimal == "comma" and "." in text:
        msg = "a point where decimals have commas"
        raise ValueError(msg)
    return text


def number_of_text(cell: str, decimal: Decimal = "point") -> float:
    """The number in a cell (which may be nan or inf); `ValueError` where there is none, or one with another mark.

    Examples
    --------
    >>> number_of_text("1,234.5"), number_of_text("1.234,5", "comma"), number_of_text("\u22121'234")
    (1234.5, 1234.5, -1234.0)
    """
    return float(python_text(cell, decimal))


def is_number(cell: str) -> bool:
    """Whether a cell reads as a number, with whichever marks (it may be nan or inf)."""
    return bool(readings(cell)) or _is_float(plain_text(cell))


def readings(cell: str) -> dict[Decimal, float]:
    """Read a cell of digits with either decimal mark.

    Examples
    --------
    >>> readings("17,971"), readings("0,971")
    ({'point': 17971.0, 'comma': 17.971}, {'comma': 0.971})
    """
    text = plain_text(cell)
    decimals: tuple[Decimal, ...] = ("point", "comma")
    return {decimal: number_of_text(text, decimal) for decimal in decimals if _PATTERNS[decimal].fullmatch(text)}


@dataclass(frozen=True, slots=True)
class Doubt:
    """A number that may be either of two, in a table that does not say which."""

    line: int
    column: int  # among the cells that were looked at
    text: str

    @property
    def values(self) -> tuple[str, str]:
        """Both readings: with decimal points, with decimal commas."""
        point, comma = (f"{value:.15g}" for value in readings(self.text).values())
        return point, comma

    @property
    def words(self) -> str:
        """The doubt, in words."""
        mark = "comma" if "," in self.text else "point"
        return f"found {self.text!r}, which is {' or '.join(self.values)}: nothing here says what the {mark} is"


@dataclass(slots=True)
class _Seen:
    """Numbers that have one mark, with three digits behind it."""

    first: Doubt
    ends_in_zero: set[int] = field(default_factory=set)  # columns


def decimal_of(rows: Iterable[tuple[int, Sequence[str]]], stated: Decimal | None = None) -> Decimal | Doubt:
    """Decide what the marks of a table mean, from its rows (line, cells); `stated` counts where all are in doubt.

    The first number that can only be read one way decides, such as 0,5 or 1,234.5: a file has one decimal mark. Else
    commas mark thousands where a column holds 2,640 beside 987: whoever writes a fixed number of decimals writes
    987,000, and whoever drops zeros writes 2,64. Points in the same place are a doubt, as decimals they are usual.
    """
    short: set[int] = set()
    seen: dict[str, _Seen] = {}
    for n, (line, cells) in enumerate(rows):
        if n >= MOST_POINTS and "," not in seen:
            break
        for k, cell in enumerate(cells):
            text = plain_text(cell)
            fits = [decimal for decimal, pattern in _PATTERNS.items() if pattern.fullmatch(text)]
            if len(fits) == 1:
                return fits[0]
            mark = next((mark for mark in ",." if mark in text), "")
            if fits and mark:
                found = seen.setdefault(mark, _Seen(Doubt(line, k, text)))
                if text.endswith("0"):
                    found.ends_in_zero.add(k)
            elif _SHORT.fullmatch(text):
                short.add(k)
    marks_thousands = {mark for mark, found in seen.items() if found.ends_in_zero & short}
    if not seen:
        return "point"
    if stated is not None:
        return stated
    if "," not in seen and not marks_thousands:
        return "point"
    if marks_thousands == {","} and "." not in seen:
        return "point"
    return (seen.get(",") or seen["."]).first


def _is_float(text: str) -> bool:
    try:
        float(text)
    except ValueError:
        return False
    return True
