# SPDX-License-Identifier: BSD-3-Clause
"""Rows of a text table: what separates their cells, and the names in the first."""

import csv
import re
from collections.abc import Callable, Iterator, Sequence
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path

from magmatch.data.tables.header_names import words_of
from magmatch.data.tables.number_marks import is_number
from magmatch.data.tables.times import seconds_of_date
from magmatch.errors import DataFormatError

# What spreadsheets write where a formula has no value (English and German): no comment.
_SHEET_ERROR = re.compile(r"#(?:N/A|NV|(?:DIV/0|VALUE|WERT|REF|BEZUG|NUM|ZAHL|NULL)!|NAME\?)\s*[,;\t]")

# Rows that may stand above a header: a title, the operator, names of groups of columns.
MAX_TITLES = 50
# What row names are called, for which a header has no name; and how a row with one begins.
ROW_NAMES, _ROW_NAME = "row names", re.compile(r'\s*"[^"]*"[\s,;]\s*[^"\s]')


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

    def cells(self) -> Iterator[tuple[int, list[str]]]:
        """Line, counted from 1, and cells of each row."""
        return ((i + 1, split_row(self.lines[i], self.delimiter)) for i in self.at)

    def header(self) -> list[str]:
        """Names in the first row; none for cells without words at its end, one for the row names of R."""
        names = split_header(self.lines[self.at[0]], self.delimiter)
        return [ROW_NAMES, *names] if self._has_row_names(len(names)) else names

    def _has_row_names(self, n: int) -> bool:
        """Whether each row below a header in quotes begins with one quoted cell more, as R's write.table does."""
        if not self.lines[self.at[0]].lstrip().startswith('"'):
            return False
        below = (self.lines[i].rstrip(" ,;\t") for i in self.at[1:])
        is_whole = len(self.at) > 1 and len(split_row(self.lines[self.at[0]], self.delimiter)) == n
        return is_whole and all(
            _ROW_NAME.match(line) and len(split_row(line, self.delimiter)) == n + 1 for line in below
        )


def rows_of(
    path: str | Path, lines: Sequence[str], is_header: Callable[[int, list[str]], bool] = lambda *_: False
) -> Rows:
    """Find the rows among the lines of a table, and what separates their cells.

    Rows above the first of which `is_header`, given its line and its cells, is sure are titles, and left out.
    """
    at = [i for i, line in enumerate(lines) if is_row(line)]
    mark = stated_delimiter(lines[at[0]]) if at else None
    at = at[mark is not None :]
    at = at[_n_titles(path, lines, at, mark, is_header) :]
    top = at[0] if at else len(lines)
    first = lines[top] if at else ""
    above = [line.strip().lstrip("#").strip() for line in lines[:top] if not is_row(line)]
    return Rows(lines, at, [line for line in above if line], mark_of(path, first, top + 1, mark) if at else None)


def _n_titles(
    path: str | Path,
    lines: Sequence[str],
    at: Sequence[int],
    mark: str | None,
    is_header: Callable[[int, list[str]], bool],
) -> int:
    """Count the rows above the first that is a header for sure; none where no row is, or numbers stand above it."""
    for n, i in enumerate(at[:MAX_TITLES]):
        with suppress(DataFormatError):  # what is no header
            cells = split_header(lines[i], mark_of(path, lines[i], i + 1, mark))
            if cells and is_header(i + 1, cells):
                return n
            if len(cells) > 1 and all(is_sample(cell) for cell in cells if cell):
                return 0  # samples, which no header may hide
    return 0


def mark_of(path: str | Path, row: str, line: int, stated: str | None) -> str | None:
    """What separates the cells of a row: the mark that is stated, if the row has it."""
    return stated if stated and stated in row else delimiter_of(path, row, line)


def split_row(text: str, delimiter: str | None) -> list[str]:
    """Cells of one line."""
    if delimiter is not None and delimiter != '"' and '"' in text:
        with suppress(csv.Error):  # a cell longer than any number or name
            return next(csv.reader([text], delimiter=delimiter, skipinitialspace=True))
    return text.split(delimiter)


def split_header(first: str, delimiter: str | None) -> list[str]:
    """Names in a first row, without empty ones at its end; units in brackets belong to the names before them."""
    has_marks = delimiter is not None or any(mark in first for mark in ",;\t")
    cells = split_row(first, delimiter) if has_marks else words_of(first)
    names = [cell.strip().strip("'\"") for cell in cells]
    while names and not names[-1]:
        names.pop()
    return names


def numbered_names(names: list[str], numbers: Sequence[int]) -> tuple[tuple[str, ...], bool]:
    """Names of columns of which some are known by number, counted from 1; and whether the first row is a header.

    It is one where a column so known has no number in it, or where its cells just count the columns.
    """
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


def listed(names: Sequence[str]) -> str:
    """Column names for a message; a file that is no table at all may have thousands."""
    shown = [name[:30] if name.isprintable() else "(unprintable)" for name in names[:15]]
    return ", ".join(name or "(unnamed)" for name in shown) + (", ..." if len(names) > len(shown) else "")


def is_sample(text: str) -> bool:
    """Whether a cell reads as a number or a date, and so not as a name."""
    return is_number(text) or seconds_of_date(text) is not None
