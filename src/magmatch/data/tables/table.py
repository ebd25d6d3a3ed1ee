# SPDX-License-Identifier: BSD-3-Clause
"""Text tables of numbers: read by column name, faults found by line and column, written whole or not at all."""

import csv
import logging
from collections.abc import Callable, Collection, Mapping, Sequence
from dataclasses import dataclass, field, replace
from io import TextIOWrapper
from pathlib import Path
from typing import Literal

import numpy as np
from scipy.spatial.transform import Rotation

from magmatch.atomic import atomic_write
from magmatch.data.tables.number_marks import Decimal, decimal_of_cells
from magmatch.data.tables.numbers import RECOVER, NumberReader
from magmatch.data.tables.text import text_lines
from magmatch.data.tables.text_rows import (
    Rows,
    advice_on_comments,
    is_sample,
    listed,
    numbered_names,
    rows_of,
)
from magmatch.errors import DataFormatError
from magmatch.number_text import exact, many, told
from magmatch.typing import Indices, Matrix, Scalars

logger = logging.getLogger(__name__)

# Columns that a row names if it is a header for sure: a title may hold a word that is one by chance.
SURE_NAMES = 3
# Rows that are written at a time.
CHUNK_ROWS = 20_000
QUATERNION = ("qx", "qy", "qz", "qw")
# Two decimals, the coarsest rounding seen in logs, move the norm by at most 1 %; more than 5 % is no quaternion.
MAX_NORM_ERROR = 0.05


@dataclass(frozen=True, eq=False, slots=True)
class Table:
    """Number columns of a text file, with the line each row stands on."""

    path: Path  # the file, for messages
    names: tuple[str, ...]  # all columns of the header, lower case, in the file's order
    columns: dict[str, Scalars]  # each (n,): the columns that were asked for and are there; all values finite
    line_numbers: Indices  # (n,): line of each row, counted from 1
    comments: tuple[str, ...]  # comment lines above the first row, without the ``#``
    # Columns of words that were asked for and are there, with the word of each row
    words: Mapping[str, Sequence[str]] = field(default_factory=dict)
    decimal: Decimal = "point"  # the mark of the numbers in the file
    header: tuple[str, ...] = ()  # the names as they stand there, lower case; none where numbers stand in their place
    header_line: int | None = None  # the line of names, counted from 1
    advice: str = ""  # what to do where columns are missing

    def __len__(self) -> int:
        return len(self.line_numbers)

    def has(self, *names: str) -> bool:
        """Whether all these columns are there."""
        return all(name in self.columns for name in names)

    def require(self, names: Sequence[str], advice: str = "") -> None:
        """Raise DataFormatError, naming what was expected and found, unless all these columns are there."""
        missing = [name for name in names if name not in self.columns]
        if missing:
            message = f"expected columns {', '.join(names)}; missing {', '.join(missing)}; found {listed(self.names)}"
            raise DataFormatError(self.path, _advised(message, advice or self.advice), line=self.header_line)

    def renamed(self, names: Mapping[str, str]) -> "Table":
        """Return the table with columns under other names, given as {old: new}."""
        columns = {names.get(name, name): values for name, values in self.columns.items()}
        return replace(self, columns=columns)

    def stack(self, *names: str) -> Matrix:
        """Columns side by side: (n, k)."""
        return np.column_stack([self.columns[name] for name in names])

    def rotations(self) -> Rotation | None:
        """Orientations of the rows; None where no column is one of a quaternion."""
        present = [name for name in QUATERNION if self.has(name)]
        if not present:
            return None
        if len(present) < len(QUATERNION):
            missing = ", ".join(name for name in QUATERNION if name not in present)
            message = f"half a quaternion: found {', '.join(present)}, missing {missing}"
            raise DataFormatError(self.path, message, column=missing)
        quaternions = self.stack(*QUATERNION)
        with np.errstate(over="ignore"):  # absurd numbers become infinite, and are refused as such
            norms = np.linalg.norm(quaternions, axis=1)
        wrong = np.flatnonzero(np.abs(norms - 1) > MAX_NORM_ERROR)
        if len(wrong):
            row = int(wrong[0])
            found = "a zero quaternion" if norms[row] == 0 else f"one of length {norms[row]:.4g}"
            message = f"expected a unit quaternion, found {found}"
            raise DataFormatError(self.path, message, line=int(self.line_numbers[row]), column="qx..qw")
        return Rotation.from_quat(quaternions)

    def require_increasing(self, name: str) -> None:
        """Raise DataFormatError at the first row where a column does not increase."""
        values = self.columns[name]
        wrong = np.flatnonzero(np.diff(values) <= 0)
        if len(wrong):
            row = int(wrong[0]) + 1
            kind = "repeats" if values[row] == values[row - 1] else "runs backward"
            message = (
                f"time {kind}: {told(values[row])} after {told(values[row - 1])}; expected strictly increasing times "
                "of one recording, whose rows are sorted by time"
            )
            if kind == "repeats":
                message += " (too coarse, as whole seconds or single precision? A survey takes --rate HZ instead)"
            raise DataFormatError(self.path, message, line=int(self.line_numbers[row]), column=name)


@dataclass(frozen=True, eq=False, slots=True)
class Wanted:
    """The columns of a table that are to be read, and how they are."""

    known: Collection[str]  # names, lower case; other columns are ignored, whatever they hold
    names: Sequence[str] | None = None  # all columns, of formats without a header row
    words: Collection[str] = ()  # columns that hold words
    # Picks the columns, {theirs: ours}, from the names there are, where names alone do not tell.
    choose: Callable[[Sequence[str]], Mapping[str, str]] | None = None
    numbered: Sequence[int] = ()  # columns known by number, counted from 1, for which no header is needed
    # Which mark is decimal, where the numbers leave that in doubt; "": not stated. None: there is no such choice.
    decimal: Decimal | Literal[""] | None = None
    # Columns that count units of 10**-digits, by our names, such as {"t": 9}; returned in whole units, rounded once.
    digits: Mapping[str, int] = field(default_factory=dict)
    # Whether to leave out rows that cannot be read, and say how many; None: there is no such choice.
    recover: bool | None = None
    header_line: int | None = None  # the line of names, where it is known; else the first row that is sure to be it
    # What to do about a file without some of the columns, from the names it has.
    advise: Callable[[Sequence[str]], str] = lambda _: ""

    def chosen(self, names: Sequence[str]) -> Mapping[str, str]:
        """Our names of the columns to read, by the table's."""
        return {name: name for name in self.known} if self.choose is None else self.choose(names)

    def is_header(self, line: int, cells: Sequence[str]) -> bool:
        """Whether a row is the header for sure; where columns have numbers, whether it is wider than a title."""
        if self.names is not None:
            return False
        if self.numbered:
            return len(cells) >= max(self.numbered) - 1  # R has no name for its row names
        if self.header_line is not None:
            return line == self.header_line
        names = [cell.lower() for cell in cells]
        return len(self.chosen(names).keys() & set(names)) >= min(SURE_NAMES, len(self.known))


def read_table(path: str | Path, wanted: Wanted, lines: Sequence[str] | None = None) -> Table:
    """Read columns of a delimited text file; every number is finite, and there is at least one row.

    Lines that start with ``#`` and blank lines are skipped, and so are titles: rows above one that names three of the
    columns at least (or all, where fewer are known), or that has a cell for each number of a column. Cells are split
    at the delimiter of the header: comma, semicolon, tab, or else white space; or the one that a first line ``sep=;``
    states. Numbers may have decimal commas and groups of three digits. Dates (ISO 8601) of times become seconds since
    1970. ``lines`` are the file's own, where they are known already.
    """
    rows = rows_of(path, text_lines(path) if lines is None else lines, wanted.is_header)
    if not rows.at:
        raise DataFormatError(path, "holds only comments and blank lines, expected rows of numbers")
    cells = [] if wanted.names is not None else [cell.lower() for cell in rows.header()]
    names, is_header = _names(path, rows, cells, wanted)
    header_line = rows.at[0] + 1 if is_header else None
    header = tuple(cells) if is_header else ()
    rows = replace(rows, at=rows.at[is_header:])
    try:
        chosen = wanted.chosen(names)
    except DataFormatError as error:
        raise DataFormatError(path, error.message, line=header_line) from None
    if not rows.at:
        raise DataFormatError(path, "has a header row but no samples under it")
    places = {name: k for k, name in enumerate(names) if name in chosen}
    if not places:
        message = f"expected columns such as {listed(tuple(wanted.known))}; found {listed(names)}"
        if any(map(is_sample, names)):
            message += advice_on_comments(rows.comments, len(names))
        if is_header and not any(map(is_sample, next(rows.cells())[1])):
            message += "; if the header stands further down, delete the rows above it"
        raise DataFormatError(path, _advised(message, wanted.advise(names)), line=header_line)
    marked = ((line, [cells[k] for k in places.values() if k < len(cells)]) for line, cells in rows.cells())
    reader = NumberReader(
        path,
        names,
        places,
        decimal_of_cells(path, marked, tuple(places), wanted.decimal),
        digits={name: wanted.digits[ours] for name, ours in chosen.items() if wanted.digits.get(ours)},
        clocks={name for name in places if chosen[name] == "t" or chosen[name] in wanted.digits},
        words={name: k for k, name in enumerate(names) if name in wanted.words},
        recover=wanted.recover,
        delimiter=rows.delimiter,
        last_line=len(rows.lines),
    )
    block, line_numbers, words = reader.read(rows.cells())
    columns = {name: block[:, k].copy() for k, name in enumerate(places)}
    comments = tuple(rows.comments)
    about = reader.decimal, header, header_line, wanted.advise(names)
    return Table(Path(path), names, columns, line_numbers, comments, words, *about)


def _names(path: str | Path, rows: Rows, cells: list[str], wanted: Wanted) -> tuple[tuple[str, ...], bool]:
    """Names of all columns, lower case, and whether the first row, of these cells, is a header."""
    if wanted.names is not None:
        return tuple(wanted.names), False
    if wanted.numbered:
        return numbered_names(cells, wanted.numbered)
    line = rows.at[0] + 1
    if all(map(is_sample, cells)):
        message = f"expected a header row that names the columns ({', '.join(wanted.known)}), found numbers"
        message += advice_on_comments(rows.comments, len(cells))
        raise DataFormatError(path, _advised(message, wanted.advise(cells)), line=line)
    for name in cells:
        if name in wanted.known and cells.count(name) > 1:
            message = f"the column appears {cells.count(name)} times; rename the others"
            raise DataFormatError(path, message, line=line, column=name)
    return tuple(cells), True


def _advised(message: str, advice: str) -> str:
    return f"{message}. {advice}" if advice else message


def table_of_columns(
    path: str | Path, columns: Mapping[str, Scalars], *, recover: bool | None = None, comments: tuple[str, ...] = ()
) -> Table:
    """Table of columns of one length, by the file's names; all finite. `recover` as in `Wanted`."""
    lengths = {name: len(values) for name, values in columns.items()}
    if len(set(lengths.values())) > 1:
        found = ", ".join(f"{name} {n}" for name, n in lengths.items())
        raise DataFormatError(path, f"expected arrays of one length, found {found}")
    block = np.column_stack([*columns.values(), np.zeros(max(lengths.values(), default=0))])
    is_finite = np.isfinite(block).all(axis=1)
    if not is_finite.all():
        row = int(np.argmin(is_finite))
        name = next(name for name, values in columns.items() if not np.isfinite(values[row]))
        message = "expected a finite number, found none, NaN or infinity"
        if recover and is_finite.any():
            left_out = many(int((~is_finite).sum()), "row")
            words = "%s: left out %s that cannot be read, the first: line %d, column '%s': %s"
            logger.warning(words, path, left_out, row + 1, name, message)
        else:
            also = "" if recover is None else RECOVER
            raise DataFormatError(path, message + also, line=row + 1, column=name)
    numbers = np.flatnonzero(is_finite)
    kept = {name: values[numbers] for name, values in columns.items()}
    return Table(Path(path), tuple(columns), kept, numbers + 1, comments)


def write_table(path: str | Path, columns: Mapping[str, Scalars | list[str]]) -> None:
    """Write columns of numbers or words as CSV; numbers read back the same."""
    n = len(next(iter(columns.values())))
    with atomic_write(path) as stream:
        text = TextIOWrapper(stream, "utf-8", newline="")
        writer = csv.writer(text, lineterminator="\n")
        writer.writerow(columns)
        for start in range(0, n, CHUNK_ROWS):
            parts = (column[start : start + CHUNK_ROWS] for column in columns.values())
            cells = (part if isinstance(part, list) else exact(part) for part in parts)
            writer.writerows(zip(*cells, strict=True))
        text.detach()
