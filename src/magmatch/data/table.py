# SPDX-License-Identifier: BSD-3-Clause
"""Text tables of numbers: read by column name, faults found by line and column, written whole or not at all."""

import csv
from collections.abc import Collection, Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from magmatch.atomic import atomic_write
from magmatch.data.text import Block, text_blocks
from magmatch.errors import DataFormatError
from magmatch.typing import Indices, Matrix, Scalars

# Rows turned into numbers at a time: text cells are bulky, so a long log is never held as cells all at once.
CHUNK_ROWS = 20_000
# Comment lines above the first row that are kept.
MAX_COMMENTS = 1000


@dataclass(frozen=True, eq=False, slots=True)
class Table:
    """Number columns of a text file, with the line each row stands on.

    Attributes
    ----------
    path : Path
        The file, for messages.
    names : tuple of str
        All columns of the header, lower case, in the file's order.
    columns : dict of str to (n,) array
        The columns that were asked for and are there; all values finite.
    line_numbers : (n,) int array
        Line of each row, counted from 1.
    comments : tuple of str
        Comment lines above the first row, without the ``#``.
    """

    path: Path
    names: tuple[str, ...]
    columns: dict[str, Scalars]
    line_numbers: Indices
    comments: tuple[str, ...]

    def __len__(self) -> int:
        return len(self.line_numbers)

    def has(self, *names: str) -> bool:
        """Whether all these columns are there."""
        return all(name in self.columns for name in names)

    def require(self, names: Sequence[str], hint: str = "") -> None:
        """Raise DataFormatError, naming what was expected and found, unless all these columns are there."""
        missing = [name for name in names if name not in self.columns]
        if missing:
            message = (
                f"expected columns {', '.join(names)}; missing {', '.join(missing)}; found {_listed(self.names)}"
            )
            raise DataFormatError(self.path, f"{message}. {hint}" if hint else message)

    def renamed(self, names: Mapping[str, str]) -> "Table":
        """Return the table with columns under other names, given as {old: new}."""
        columns = {names.get(name, name): values for name, values in self.columns.items()}
        return Table(self.path, self.names, columns, self.line_numbers, self.comments)

    def stack(self, *names: str) -> Matrix:
        """Columns side by side: (n, k)."""
        return np.column_stack([self.columns[name] for name in names])

    def require_increasing(self, name: str) -> None:
        """Raise DataFormatError at the first row where a column does not increase."""
        values = self.columns[name]
        wrong = np.flatnonzero(np.diff(values) <= 0)
        if len(wrong):
            row = int(wrong[0]) + 1
            kind = "repeats" if values[row] == values[row - 1] else "runs backward"
            message = (
                f"time {kind}: {values[row]:.9g} after {values[row - 1]:.9g}; expected strictly increasing times"
            )
            raise DataFormatError(self.path, message, line=int(self.line_numbers[row]), column=name)


def read_table(
    path: str | Path, known: Collection[str], names: Sequence[str] | None = None, raw: bytes | None = None
) -> Table:
    """Read the known columns of a delimited text file.

    Lines that start with ``#`` and blank lines are skipped. Cells are split at the delimiter of the header: comma,
    semicolon, tab, or else white space.

    Parameters
    ----------
    path : path
        The file.
    known : collection of str
        Columns to read where present, lower case; others are ignored, whatever they hold.
    names : sequence of str, optional
        The columns, for formats without a header row; by default the first row names them.
    raw : bytes, optional
        The content, where it is not that of a file of its own (a member of an archive).

    Returns
    -------
    Table
        At least one row; every number finite.

    Raises
    ------
    DataFormatError
        With line and column wherever one is at fault.
    """
    reader = _TableReader(path, known, names)
    for block in text_blocks(path, raw):
        reader.take(block)
    return reader.table()


class _TableReader:
    """Turns a table into numbers block by block."""

    def __init__(self, path: str | Path, known: Collection[str], names: Sequence[str] | None) -> None:
        self.path, self.known, self.names = path, known, names
        self.comments: list[str] = []
        self.has_begun = False
        self.delimiter: str | None = None
        self.wanted: dict[str, int] = {}
        self.columns: list[list[Scalars]] = []
        self.line_numbers: list[Indices] = []

    def take(self, block: Block) -> None:
        """Read the rows of a block; its first row may be the header."""
        lines = block.lines
        # A row of delimiters alone is what spreadsheets write for a blank line.
        rows = [
            i for i, line in enumerate(lines) if (text := line.strip()) and text[0] != "#" and text.strip(",; \t")
        ]
        if not self.has_begun:
            above = lines[: rows[0]] if rows else lines
            self.comments += [line.strip().lstrip("#").strip() for line in above if line.strip()][:MAX_COMMENTS]
        if rows and not self.has_begun:
            self._begin(lines, rows, block.start)
        if rows and not self.wanted:
            self._choose()
        for start in range(0, len(rows), CHUNK_ROWS):
            chunk = rows[start : start + CHUNK_ROWS]
            is_last = block.is_last and chunk[-1] == len(lines) - 1
            self._take_rows([lines[i] for i in chunk], [block.start + i for i in chunk], is_last=is_last)

    def _begin(self, lines: list[str], rows: list[int], start: int) -> None:
        """Learn delimiter and names from the first row."""
        self.has_begun = True
        first = lines[rows[0]]
        self.delimiter = _delimiter(self.path, first, start + rows[0] + 1)
        if self.names is None:
            cells, line = _split(first, self.delimiter), start + rows.pop(0) + 1
            self.names = _header(self.path, cells, line, self.known, self.comments)

    def _choose(self) -> None:
        """Which columns to read, at the first row of numbers."""
        names = self.names or ()
        self.wanted = {name: k for k, name in enumerate(names) if name in self.known}
        if not self.wanted:
            message = f"expected columns such as {_listed(tuple(self.known))}; found {_listed(names)}"
            raise DataFormatError(self.path, message)
        self.columns = [[] for _ in self.wanted]

    def _take_rows(self, rows: list[str], numbers: list[int], *, is_last: bool) -> None:
        names = self.names or ()
        block = _numbers_at_once(rows, self.delimiter, len(names), self.wanted)
        if block is None:
            cells = _cells(self.path, rows, numbers, self.delimiter, names, is_last=is_last)
            block = _numbers(self.path, numbers, cells, self.wanted)
        for parts, values in zip(self.columns, block.T, strict=True):
            parts.append(values.copy())
        self.line_numbers.append(np.array(numbers, dtype=np.int64) + 1)

    def table(self) -> Table:
        """All that was read."""
        if not self.has_begun:
            raise DataFormatError(self.path, "holds only comments and blank lines, expected rows of numbers")
        if not self.line_numbers:
            raise DataFormatError(self.path, "has a header row but no samples under it")
        columns = {}
        for name in self.wanted:  # one after the other, so that little is there twice
            columns[name] = np.concatenate(self.columns.pop(0))
        numbers = np.concatenate(self.line_numbers)
        return Table(Path(self.path), tuple(self.names or ()), columns, numbers, tuple(self.comments))


def write_table(path: str | Path, columns: Mapping[str, Scalars], comments: Sequence[str] = ()) -> None:
    """Write number columns as CSV, so that reading them gives the same float64 values.

    Parameters
    ----------
    path : path
        Where; an existing file is replaced only once the new one is complete.
    columns : mapping of str to (n,) array
        Column names and values, in the order to write.
    comments : sequence of str
        Lines to put above the header, without the ``#``.
    """
    with atomic_write(path) as stream:
        stream.writelines(_rows(columns, comments))


def _rows(columns: Mapping[str, Scalars], comments: Sequence[str]) -> Iterator[bytes]:
    """Encode a table piece by piece."""
    head = [f"# {comment}" for comment in comments] + [",".join(columns)]
    yield ("\n".join(head) + "\n").encode()
    n = len(next(iter(columns.values())))
    for start in range(0, n, CHUNK_ROWS):
        texts = [map(repr, column[start : start + CHUNK_ROWS].tolist()) for column in columns.values()]
        yield ("\n".join(map(",".join, zip(*texts, strict=True))) + "\n").encode()


def _delimiter(path: str | Path, first: str, line: int) -> str | None:
    """Choose what separates the cells from the first row; None for white space."""
    if "," in first and ";" in first:
        raise DataFormatError(path, "both ',' and ';' separate the columns here; use one of them", line=line)
    return next((mark for mark in (",", ";", "\t") if mark in first), None)


def _split(text: str, delimiter: str | None) -> list[str]:
    """Cells of one line."""
    if delimiter is not None and '"' in text:
        return next(csv.reader([text], delimiter=delimiter, skipinitialspace=True))
    return text.split(delimiter)


def _header(
    path: str | Path, cells: list[str], line: int, known: Collection[str], comments: Sequence[str]
) -> tuple[str, ...]:
    """Names of the columns, lower case."""
    names = [cell.strip().strip("'\"").lower() for cell in cells]
    while names and not names[-1]:
        names.pop()
    if all(_is_number(name) for name in names):
        message = f"expected a header row that names the columns ({', '.join(known)}), found numbers"
        if any(len(set(comment.replace(",", " ").lower().split()) & set(known)) > 2 for comment in comments):
            message += "; the line of names above it starts with '#', which makes it a comment: remove the '#'"
        raise DataFormatError(path, message, line=line)
    for name in names:
        if name in known and names.count(name) > 1:
            raise DataFormatError(path, f"the column stands {names.count(name)} times", line=line, column=name)
    return tuple(names)


def _numbers_at_once(rows: list[str], delimiter: str | None, width: int, wanted: Mapping[str, int]) -> Matrix | None:
    """Wanted columns of some rows by NumPy's parser; None where any row needs a closer look."""
    if delimiter is None or not wanted or any(row.count(delimiter) != width - 1 for row in rows):
        return None
    try:
        block = np.loadtxt(rows, delimiter=delimiter, comments=None, usecols=list(wanted.values()), ndmin=2)
    except ValueError:
        return None
    return block if len(block) == len(rows) and np.isfinite(block).all() else None


def _cells(
    path: str | Path, rows: list[str], chunk: list[int], delimiter: str | None, names: Sequence[str], *, is_last: bool
) -> list[list[str]]:
    """Cells of some rows, each as many as there are columns."""
    width = len(names)
    cells = [_split(row, delimiter) for row in rows]
    for i, row in zip(chunk, cells, strict=True):
        while len(row) > width and not row[-1].strip():
            row.pop()
        if len(row) != width:
            message = f"expected {width} cells ({_listed(names)}), found {len(row)}"
            if is_last and i == chunk[-1] and len(row) < width:
                message += "; the file ends in the middle of this line: cut off?"
            raise DataFormatError(path, message, line=i + 1)
    return cells


def _numbers(path: str | Path, chunk: list[int], rows: list[list[str]], wanted: Mapping[str, int]) -> Matrix:
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
            if not _is_number(text):
                hint = " (write decimals with a point)" if _is_number(text.replace(",", ".")) else ""
                return DataFormatError(path, f"expected a number, found {text[:40]!r}{hint}", line=i + 1, column=name)
            if not np.isfinite(float(text)):
                message = f"expected a finite number, found {text[:40]!r}; remove the row or repair it"
                return DataFormatError(path, message, line=i + 1, column=name)
    msg = "a fault was reported but none found"
    raise AssertionError(msg)


def _listed(names: Sequence[str]) -> str:
    """Column names for a message; a file that is no table at all may have thousands."""
    shown = [name[:30] if name.isprintable() else "(unprintable)" for name in names[:15]]
    return ", ".join(name or "(unnamed)" for name in shown) + (", ..." if len(names) > len(shown) else "")


def _is_number(text: str) -> bool:
    """Whether a cell reads as a number (which may be nan or inf)."""
    try:
        float(text)
    except ValueError:
        return False
    return True
