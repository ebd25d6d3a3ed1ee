# SPDX-License-Identifier: BSD-3-Clause
"""Cells of text rows: names in the first row, numbers in the others, faults by line and column."""

import csv
import re
from collections.abc import Callable, Collection, Iterable, Mapping, Sequence
from dataclasses import dataclass
from math import isfinite
from pathlib import Path
from typing import Literal

import numpy as np

from magmatch.data.tables.dates import seconds_of_date
from magmatch.data.tables.header_names import words_of
from magmatch.data.tables.nanoseconds import LARGEST_WHOLE, seconds_of_text
from magmatch.data.tables.number_marks import Decimal, Doubt, decimal_of, is_number, number_of_text
from magmatch.errors import DataFormatError
from magmatch.typing import Matrix


class ForeignNumberError(DataFormatError):
    """A row holds numbers, but written in a way that is not read: no damage, and not to be left out."""


RECOVER = "; --recover leaves such rows out"
# What spreadsheets write where a formula has no value (English and German): no comment.
_SHEET_ERROR = re.compile(r"#(?:N/A|NV|(?:DIV/0|VALUE|WERT|REF|BEZUG|NUM|ZAHL|NULL)!|NAME\?)\s*[,;\t]")


def is_row(line: str) -> bool:
    """Whether a line is none that is blank or a comment; delimiters alone are what spreadsheets write for a blank."""
    text = line.strip()
    return bool(text.strip(",; \t")) and (text[0] != "#" or _SHEET_ERROR.match(text) is not None)


def stated_delimiter(line: str) -> str | None:
    """The mark that a first line such as ``sep=;`` states, by which spreadsheets are told what separates cells."""
    found = re.fullmatch(r"""["']?sep=(.)["']?[,;\s]*""", line.strip(" \ufeff"), re.IGNORECASE)
    return found[1] if found else None


def delimiter_of(path: str | Path, first: str, line: int) -> str | None:
    """Choose what separates the cells from the first row; None for white space."""
    for mark in (";", None):  # between numbers with decimal commas
        cells = [cell.strip() for cell in first.split(mark)]
        if "," in first and len(cells) > 1 and all(is_number(cell) and cell[-1] != "," for cell in cells):
            return mark
    if "," in first and ";" in first:
        message = "both ',' and ';' separate the columns here; use one of them, or write sep=; above for the second"
        raise DataFormatError(path, message, line=line)
    return next((mark for mark in (",", ";", "\t") if mark in first), None)


@dataclass(frozen=True, slots=True)
class Rows:
    """The rows of a table; the first may be its header."""

    lines: Sequence[str]  # all lines of the file
    at: list[int]  # which of them are rows
    comments: list[str]  # lines above the first row, without the ``#``
    delimiter: str | None  # between cells; None for white space
    # Where the lines stand in the file, counted from 0, if not one behind another.
    numbers: Sequence[int] | None = None

    def numbered(self, at: list[int]) -> list[int]:
        """Give the places of some lines in the file."""
        return at if self.numbers is None else [self.numbers[i] for i in at]


def rows_of(path: str | Path, lines: Sequence[str]) -> Rows:
    """Find the rows among the lines of a table, and what separates their cells."""
    at = [i for i, line in enumerate(lines) if is_row(line)]
    mark = stated_delimiter(lines[at[0]]) if at else None
    at = at[mark is not None :]
    top = at[0] if at else len(lines)
    first = lines[top] if at else ""
    above = [line.strip().lstrip("#").strip() for line in lines[:top] if not is_row(line)]
    delimiter = mark if mark and mark in first else delimiter_of(path, first, top + 1)
    return Rows(lines, at, [line for line in above if line], delimiter)


def split_row(text: str, delimiter: str | None) -> list[str]:
    """Cells of one line."""
    if delimiter is not None and '"' in text:
        return next(csv.reader([text], delimiter=delimiter, skipinitialspace=True))
    return text.split(delimiter)


def split_header(first: str, delimiter: str | None) -> list[str]:
    """Cells of the first row; units in brackets belong to the names before them."""
    has_marks = delimiter is not None or any(mark in first for mark in ",;\t")
    return split_row(first, delimiter) if has_marks else words_of(first)


def names_of(
    path: str | Path,
    cells: list[str],
    line: int,
    known: Collection[str],
    comments: Sequence[str],
    advise: Callable[[Sequence[str]], str] = lambda _: "",
) -> tuple[str, ...]:
    """Names of the columns, lower case."""
    names = [cell.strip().strip("'\"").lower() for cell in cells]
    while names and not names[-1]:
        names.pop()
    if all(map(is_sample, names)):
        message = f"expected a header row that names the columns ({', '.join(known)}), found numbers"
        message += advice_on_comments(comments, len(names))
        advice = advise(names)
        raise DataFormatError(path, f"{message}. {advice}" if advice else message, line=line)
    for name in names:
        if name in known and names.count(name) > 1:
            raise DataFormatError(
                path, f"the column appears {names.count(name)} times; rename the others", line=line, column=name
            )
    return tuple(names)


def numbered_names(cells: list[str], numbers: Sequence[int]) -> tuple[tuple[str, ...], bool]:
    """Names of columns of which some are known by number, counted from 1; and whether the first row is a header.

    It is one where a column so known has no number in it, or where its cells just count the columns.
    """
    names = [cell.strip().strip("'\"").lower() for cell in cells]
    while names and not names[-1]:
        names.pop()
    counted = [str(k) for k in range(len(names) + 1)]
    if len(names) > 1 and names in (counted[:-1], counted[1:]):
        return tuple(names), True
    known = [k for k in numbers if k <= len(names) and str(k) not in names]
    is_header = not all(is_sample(names[k - 1]) for k in known)
    named = (str(k) if k in known or not is_header else name for k, name in enumerate(names, start=1))
    return tuple(named), is_header


def advice_on_comments(comments: Sequence[str], n: int) -> str:
    """Advise where a comment holds the n names that are missing."""
    for words in map(words_of, comments):
        if len(words) == n and not any(map(is_number, words)):
            return "; the line of names above it starts with '#', which makes it a comment: remove the '#'"
    return ""


def numbers_at_once(
    rows: list[str], delimiter: str | None, width: int, wanted: Mapping[str, int], decimal: Decimal
) -> Matrix | None:
    """Wanted columns of some rows by NumPy's parser; None where any row needs a closer look."""
    if any((row.count(delimiter) + 1 if delimiter else len(row.split())) != width for row in rows):
        return None
    if decimal == "comma":
        if delimiter == "," or any("." in row for row in rows):
            return None
        rows = [row.replace(",", ".") for row in rows]
    try:
        block = np.loadtxt(rows, delimiter=delimiter, comments=None, usecols=list(wanted.values()), ndmin=2)
    except ValueError:
        return None
    return block if len(block) == len(rows) and np.isfinite(block).all() else None


def cells_of(
    path: str | Path, rows: list[str], chunk: list[int], delimiter: str | None, names: Sequence[str], *, is_last: bool
) -> list[list[str]]:
    """Cells of some rows, each as many as there are columns."""
    width = len(names)
    cells = [split_row(row, delimiter) for row in rows]
    for i, row in zip(chunk, cells, strict=True):
        while len(row) > width and not row[-1].strip():
            row.pop()
        if len(row) != width:
            message = f"expected {width} cells ({listed(names)}), found {len(row)}"
            if is_last and i == chunk[-1] and len(row) < width:
                message += "; the file ends in the middle of this line: cut off?"
            if delimiter == "," and len(row) > width and all(map(is_number, row)):
                advice = (
                    "numbers that hold commas need quotes, or semicolons between the cells; row numbers need a name"
                )
                raise ForeignNumberError(path, f"{message}; {advice}", line=i + 1)
            raise DataFormatError(path, message, line=i + 1)
    return cells


def put_seconds(rows: list[list[str]], column: int, decimal: Decimal) -> bool:
    """Write the dates of a column as numbers of seconds, with the table's decimal mark; whether there are any."""
    has_dates = False
    for row in rows:
        if (seconds := seconds_of_date(row[column])) is not None:
            row[column] = repr(seconds).replace(".", "." if decimal == "point" else ",")
            has_dates = True
    return has_dates


def numbers_of(
    path: str | Path,
    chunk: list[int],
    rows: list[list[str]],
    wanted: Mapping[str, int],
    decimal: Decimal = "point",
    digits: Mapping[str, int] | None = None,
) -> Matrix:
    """Wanted columns of some rows, one cell at a time; `digits` as in `read_table`."""
    lines = zip(chunk, rows, strict=True)
    block = np.array([[_number(path, i, name, row[k], decimal) for name, k in wanted.items()] for i, row in lines])
    in_units(block, lambda k: (row[k] for row in rows), wanted, decimal, digits or {})
    return block


def _number(path: str | Path, i: int, name: str, cell: str, decimal: Decimal) -> float:
    """The finite number in a cell; DataFormatError says what is there instead."""
    try:
        value = float(cell)
        if decimal == "comma" and "." in cell:
            raise ValueError  # noqa: TRY301
    except ValueError:
        text = cell.strip()
        if not text:
            raise DataFormatError(path, "expected a number, found an empty cell", line=i + 1, column=name) from None
        try:
            value = number_of_text(text, decimal)
        except ValueError:
            kind, hint = advice_on(text, decimal)
            raise kind(path, f"expected a number, found {text[:40]!r}{hint}", line=i + 1, column=name) from None
    if not isfinite(value):
        message = f"expected a finite number, found {cell.strip()[:40]!r}; remove the row or repair it"
        raise DataFormatError(path, message, line=i + 1, column=name)
    return value


def decimal_of_cells(
    path: str | Path,
    rows: Iterable[tuple[int, Sequence[str]]],
    names: Sequence[str],
    stated: Decimal | Literal[""] | None = None,
) -> Decimal:
    """The decimal mark of rows (line, cells of named columns); one that they leave in doubt is refused.

    `stated` as in `read_table`.
    """
    found = decimal_of(rows, stated or None)
    if not isinstance(found, Doubt):
        return found
    point, comma = found.values
    advice = f"write {point} or {comma}"
    if stated is not None:
        advice += f", or state the mark: --decimal point reads {point}, --decimal comma {comma}"
    raise DataFormatError(path, f"{found.words}; {advice}", line=found.line, column=names[found.column])


def in_units(
    block: Matrix,
    cells: Callable[[int], Iterable[str]],
    wanted: Mapping[str, int],
    decimal: Decimal,
    digits: Mapping[str, int],
) -> None:
    """Turn columns of a block into whole units, rounded once: what float64 cannot hold is taken from the cells again.

    `cells` gives a column of the file by its number.
    """
    for column, name in enumerate(wanted):
        if places := digits.get(name, 0):
            values = block[:, column]
            if (np.abs(values) < LARGEST_WHOLE).all() and (values == np.rint(values)).all():
                block[:, column] = values / 10.0**places
            else:
                block[:, column] = [seconds_of_text(text, places, decimal) for text in cells(wanted[name])]


def advice_on(text: str, decimal: Decimal) -> tuple[type[DataFormatError], str]:
    """Advise about a cell that is no number; rows of digits are no damage."""
    if text.count(":") > 1:
        return ForeignNumberError, " (times are numbers, or dates such as 2024-05-01T10:00:00.25+02:00)"
    if is_number(text):
        others = "points" if decimal == "point" else "commas"
        return ForeignNumberError, f", where other numbers have decimal {others} (write all decimals with a point)"
    if not text.startswith("#") and any(character.isdigit() for character in text):  # "#DIV/0!" is none
        return ForeignNumberError, " (write it without unit, brackets or other signs, such as -1234.5)"
    return DataFormatError, ""


def listed(names: Sequence[str]) -> str:
    """Column names for a message; a file that is no table at all may have thousands."""
    shown = [name[:30] if name.isprintable() else "(unprintable)" for name in names[:15]]
    return ", ".join(name or "(unnamed)" for name in shown) + (", ..." if len(names) > len(shown) else "")


def require_stated(path: str | Path, names: Sequence[str], stated: Mapping[str, str]) -> None:
    """Raise DataFormatError unless all columns that were named, {theirs, lower case: ours}, are there."""
    there = {name.lower() for name in names}
    for theirs, ours in stated.items():
        if theirs not in there:
            raise DataFormatError(path, f"expected a column '{theirs}' for {ours}, found {listed(names)}")


def is_sample(text: str) -> bool:
    """Whether a cell reads as a number or a date, and so not as a name."""
    return is_number(text) or seconds_of_date(text) is not None
