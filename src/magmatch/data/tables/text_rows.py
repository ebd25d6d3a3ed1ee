# SPDX-License-Identifier: BSD-3-Clause
"""Cells of text rows: names in the first row, numbers in the others, faults by line and column."""

import csv
from collections.abc import Callable, Collection, Mapping, Sequence
from pathlib import Path

import numpy as np

from magmatch.data.tables.dates import seconds_of_date
from magmatch.errors import DataFormatError
from magmatch.typing import Matrix


def delimiter_of(path: str | Path, first: str, line: int) -> str | None:
    """Choose what separates the cells from the first row; None for white space."""
    if "," in first and ";" in first:
        raise DataFormatError(path, "both ',' and ';' separate the columns here; use one of them", line=line)
    return next((mark for mark in (",", ";", "\t") if mark in first), None)


def split_row(text: str, delimiter: str | None) -> list[str]:
    """Cells of one line."""
    if delimiter is not None and '"' in text:
        return next(csv.reader([text], delimiter=delimiter, skipinitialspace=True))
    return text.split(delimiter)


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
        above = comments[-1].replace(",", " ").replace(";", " ").split() if comments else []
        if len(above) == len(names) and not any(map(is_number, above)):
            message += "; the line of names above it starts with '#', which makes it a comment: remove the '#'"
        advice = advise(names)
        raise DataFormatError(path, f"{message}. {advice}" if advice else message, line=line)
    for name in names:
        if name in known and names.count(name) > 1:
            raise DataFormatError(path, f"the column appears {names.count(name)} times", line=line, column=name)
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


def numbers_at_once(rows: list[str], delimiter: str | None, width: int, wanted: Mapping[str, int]) -> Matrix | None:
    """Wanted columns of some rows by NumPy's parser; None where any row needs a closer look."""
    if delimiter is None or not wanted or any(row.count(delimiter) != width - 1 for row in rows):
        return None
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
            raise DataFormatError(path, message, line=i + 1)
    return cells


def numbers_of(path: str | Path, chunk: list[int], rows: list[list[str]], wanted: Mapping[str, int]) -> Matrix:
    """Wanted columns of some rows, one cell at a time."""
    try:
        block = np.array([[float(row[k]) for k in wanted.values()] for row in rows])
        if np.isfinite(block).all():
            return block
    except ValueError:
        pass
    raise _first_fault(path, chunk, rows, wanted)


def _first_fault(
    path: str | Path, chunk: list[int], rows: list[list[str]], wanted: Mapping[str, int]
) -> DataFormatError:
    """Find the first cell that is not a finite number (slow, so done only once one is known to be there)."""
    for i, row in zip(chunk, rows, strict=True):
        for name, k in wanted.items():
            text = row[k].strip()
            if not text:
                return DataFormatError(path, "expected a number, found an empty cell", line=i + 1, column=name)
            if not is_number(text):
                hint = " (write decimals with a point)" if is_number(text.replace(",", ".")) else ""
                is_time = text.count(":") > 1
                hint = " (times are numbers, or dates such as 2024-05-01T10:00:00.25+02:00)" if is_time else hint
                return DataFormatError(path, f"expected a number, found {text[:40]!r}{hint}", line=i + 1, column=name)
            if not np.isfinite(float(text)):
                message = f"expected a finite number, found {text[:40]!r}; remove the row or repair it"
                return DataFormatError(path, message, line=i + 1, column=name)
    msg = "a fault was reported but none found"
    raise AssertionError(msg)


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


def is_number(text: str) -> bool:
    """Whether a cell reads as a number (which may be nan or inf)."""
    try:
        float(text)
    except ValueError:
        return False
    return True
