# SPDX-License-Identifier: BSD-3-Clause
"""Marks within numbers: whether a table's commas or points are decimal is decided by all of its numbers together."""

import re
from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import Literal

from magmatch.errors import DataFormatError

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
    if decimal == "point" and _is_float(cell):  # most are plain
        return cell.strip()
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
    return float_of_text(python_text(cell, decimal))


def float_of_text(text: str) -> float:
    """A number as files hold it; `ValueError` also for ``1_0``, which only Python takes for 10."""
    if "_" in text:
        msg = "an underscore in a number"
        raise ValueError(msg)
    return float(text)


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


def decimal_of_cells(
    path: str | Path,
    rows: Iterable[tuple[int, Sequence[str]]],
    names: Sequence[str],
    stated: Decimal | Literal[""] | None = None,
) -> Decimal:
    """Decide what the marks of a table mean, from its rows (line, cells of named columns); DataFormatError in doubt.

    The first number that can only be read one way decides, such as 0,5 or 1,234.5: a file has one decimal mark. Else
    commas mark thousands where a column holds 2,640 beside 987: whoever writes a fixed number of decimals writes
    987,000, and whoever drops zeros writes 2,64. Points in the same place are a doubt, as decimals they are usual.
    In doubt `stated` counts; "" is not stated, and without such a choice it is None.
    """
    short: set[int] = set()
    first: dict[str, tuple[int, int, str]] = {}  # line, column and text by the mark that has three digits behind it
    ends_in_zero: set[tuple[str, int]] = set()  # marks, and columns
    for n, (line, cells) in enumerate(rows):
        if n >= MOST_POINTS and "," not in first:
            break
        for k, cell in enumerate(cells):
            text = plain_text(cell)
            fits = [decimal for decimal, pattern in _PATTERNS.items() if pattern.fullmatch(text)]
            if len(fits) == 1:
                return fits[0]
            if fits and (mark := next((mark for mark in ",." if mark in text), "")):
                first.setdefault(mark, (line, k, text))
                ends_in_zero |= {(mark, k)} if text.endswith("0") else set()
            elif _SHORT.fullmatch(text):
                short.add(k)
    marks_thousands = {mark for mark, k in ends_in_zero if k in short}
    if first and stated:
        return stated
    if first.keys() <= {"."} - marks_thousands or (marks_thousands == {","} and "." not in first):
        return "point"
    line, k, text = first.get(",") or first["."]
    point, comma = (f"{value:.15g}" for value in readings(text).values())
    mark = "comma" if "," in text else "point"
    found = f"found {text!r}, which is {point} or {comma}: nothing here says what the {mark} is"
    advice = f"write {point} or {comma}"
    if stated is not None:
        advice += f", or state the mark: --decimal point reads {point}, --decimal comma {comma}"
    raise DataFormatError(path, f"{found}; {advice}", line=line, column=names[k])


def _is_float(text: str) -> bool:
    try:
        float_of_text(text)
    except ValueError:
        return False
    return True
