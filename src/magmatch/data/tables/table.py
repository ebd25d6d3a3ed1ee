# SPDX-License-Identifier: BSD-3-Clause
"""Text tables of numbers: read by column name, faults found by line and column, written whole or not at all."""

import logging
from collections.abc import Callable, Collection, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Literal

import numpy as np

from magmatch.atomic import atomic_write
from magmatch.data.tables.number_marks import Decimal
from magmatch.data.tables.text import text_lines
from magmatch.data.tables.text_rows import (
    RECOVER,
    ForeignNumberError,
    Rows,
    cells_of,
    decimal_of_cells,
    in_units,
    listed,
    names_of,
    numbered_names,
    numbers_at_once,
    numbers_of,
    put_seconds,
    rows_of,
    split_header,
    split_row,
)
from magmatch.errors import DataFormatError
from magmatch.number_text import exact, many, told
from magmatch.typing import Indices, Matrix, Scalars

logger = logging.getLogger(__name__)

# Rows turned into numbers at a time: cells are bulky, so a long log is never held as cells all at once.
CHUNK_ROWS = 20_000


@dataclass(frozen=True, eq=False, slots=True)
class Table:
    """Number columns of a text file, with the line each row stands on."""

    path: Path  # the file, for messages
    names: tuple[str, ...]  # all columns of the header, lower case, in the file's order
    columns: dict[str, Scalars]  # each (n,): the columns that were asked for and are there; all values finite
    line_numbers: Indices  # (n,): line of each row, counted from 1
    comments: tuple[str, ...]  # comment lines above the first row, without the ``#``
    # Columns of words that were asked for and are there, each the same in all rows
    texts: Mapping[str, str] = field(default_factory=dict)
    decimal: Decimal = "point"  # the mark of the numbers in the file

    def __len__(self) -> int:
        return len(self.line_numbers)

    def has(self, *names: str) -> bool:
        """Whether all these columns are there."""
        return all(name in self.columns for name in names)

    def require(self, names: Sequence[str], hint: str = "") -> None:
        """Raise DataFormatError, naming what was expected and found, unless all these columns are there."""
        missing = [name for name in names if name not in self.columns]
        if missing:
            message = f"expected columns {', '.join(names)}; missing {', '.join(missing)}; found {listed(self.names)}"
            raise DataFormatError(self.path, f"{message}. {hint}" if hint else message)

    def renamed(self, names: Mapping[str, str]) -> "Table":
        """Return the table with columns under other names, given as {old: new}."""
        columns = {names.get(name, name): values for name, values in self.columns.items()}
        return replace(self, columns=columns)

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
                f"time {kind}: {told(values[row])} after {told(values[row - 1])}; expected strictly increasing times "
                "of one recording, whose rows are sorted by time"
            )
            raise DataFormatError(self.path, message, line=int(self.line_numbers[row]), column=name)


@dataclass(frozen=True, eq=False, slots=True)
class Wanted:
    """The columns of a table that are to be read, and how they are."""

    known: Collection[str]  # names, lower case; other columns are ignored, whatever they hold
    names: Sequence[str] | None = None  # all columns, of formats without a header row
    delimiter: str | None = None  # what separates cells, where the header does not show it
    texts: Collection[str] = ()  # columns that hold one word for the whole file
    # Picks the columns, {theirs: ours}, from the names there are, where names alone do not tell.
    choose: Callable[[Sequence[str]], Mapping[str, str]] | None = None
    numbered: Sequence[int] = ()  # columns known by number, counted from 1, for which no header is needed
    # Which mark is decimal, where the numbers leave that in doubt; "": not stated. None: there is no such choice.
    decimal: Decimal | Literal[""] | None = None
    # Columns that count units of 10**-digits, by our names, such as {"t": 9}; returned in whole units, rounded once.
    digits: Mapping[str, int] = field(default_factory=dict)
    # Whether to leave out rows that cannot be read, and say how many; None: there is no such choice.
    recover: bool | None = None
    # What to do about a file that has none of the columns, from the names it has.
    advise: Callable[[Sequence[str]], str] = lambda _: ""


def read_table(
    path: str | Path, wanted: Wanted, lines: Sequence[str] | None = None, numbers: Sequence[int] | None = None
) -> Table:
    """Read columns of a delimited text file; every number is finite, and there is at least one row.

    Lines that start with ``#`` and blank lines are skipped. Cells are split at the delimiter of the header: comma,
    semicolon, tab, or else white space; or the one that a first line ``sep=;`` states. Numbers may have decimal
    commas and groups of three digits. Dates (ISO 8601) of times become seconds since 1970. ``lines`` are the file's
    own, where they are known already, or some of them, with their ``numbers`` there, counted from 0.
    """
    rows = rows_of(path, text_lines(path) if lines is None else lines)
    if not rows.at:
        raise DataFormatError(path, "holds only comments and blank lines, expected rows of numbers")
    rows = replace(rows, delimiter=wanted.delimiter or rows.delimiter, numbers=numbers)
    names, is_header = _names(path, rows, wanted)
    rows = replace(rows, at=rows.at[is_header:])
    chosen = {name: name for name in wanted.known} if wanted.choose is None else wanted.choose(names)
    if not rows.at:
        raise DataFormatError(path, "has a header row but no samples under it")
    places = {name: k for k, name in enumerate(names) if name in chosen}
    if not places:
        message = f"expected columns such as {listed(tuple(wanted.known))}; found {listed(names)}"
        advice = wanted.advise(names)
        raise DataFormatError(path, f"{message}. {advice}" if advice else message)
    decimal = decimal_of_cells(path, _marked_cells(rows, places), tuple(places), wanted.decimal)
    said = {name: _word_of(path, rows, name, k) for k, name in enumerate(names) if name in wanted.texts}
    digits = {name: wanted.digits[ours] for name, ours in chosen.items() if ours in wanted.digits}
    clocks = {name for name in places if chosen[name] == "t" or name in digits}
    reader = _NumberReader(path, rows, names, places, clocks, decimal, digits, wanted.recover)
    block, line_numbers = reader.read()
    columns = {name: block[:, k].copy() for k, name in enumerate(places)}
    said = {name: word for name, word in said.items() if word}
    return Table(Path(path), names, columns, line_numbers, tuple(rows.comments), said, decimal)


def _names(path: str | Path, rows: Rows, wanted: Wanted) -> tuple[tuple[str, ...], bool]:
    """Names of all columns, lower case, and whether the first row is a header."""
    if wanted.names is not None:
        return tuple(wanted.names), False
    cells = split_header(rows.lines[rows.at[0]], rows.delimiter)
    if wanted.numbered:
        return numbered_names(cells, wanted.numbered)
    return names_of(path, cells, rows.at[0] + 1, wanted.known, rows.comments, wanted.advise), True


def _marked_cells(rows: Rows, places: Mapping[str, int]) -> Iterator[tuple[int, list[str]]]:
    """Lines and wanted cells of all rows, where any may hold marks within numbers."""
    lines, mark = rows.lines, rows.delimiter
    if any("." in lines[i] or ("," in lines[i] and (mark != "," or '"' in lines[i])) for i in rows.at):
        for i, number in zip(rows.at, rows.numbered(rows.at), strict=True):
            cells = split_row(lines[i], mark)
            yield number + 1, [cells[k] for k in places.values() if k < len(cells)]


def _word_of(path: str | Path, rows: Rows, name: str, k: int) -> str:
    """The word of a column that all rows share."""
    said = ""
    for i in rows.at:
        found = "".join(split_row(rows.lines[i], rows.delimiter)[k : k + 1]).strip()
        if found and (said := said or found) != found:
            message = f"found {found[:40]!r} below {said[:40]!r}; a file holds one survey: split it"
            raise DataFormatError(path, message, line=i + 1, column=name)
    return said


@dataclass(slots=True)
class _NumberReader:
    """Reads the numbers of rows: many at once by NumPy, and what that cannot read cell by cell."""

    path: str | Path
    rows: Rows
    names: Sequence[str]
    places: Mapping[str, int]  # of the wanted columns
    clocks: Collection[str]  # columns that may hold dates
    decimal: Decimal
    digits: Mapping[str, int]
    recover: bool | None
    first_fault: DataFormatError | None = None
    has_commas: bool = False  # within numbers

    def read(self) -> tuple[Matrix, Indices]:
        """All numbers, (n, k), and the lines of the rows that were kept, counted from 1."""
        parts = [self._piece(self.rows.at[i : i + CHUNK_ROWS]) for i in range(0, len(self.rows.at), CHUNK_ROWS)]
        block, at = (np.concatenate(part) for part in zip(*parts, strict=True))
        if self.first_fault is not None:
            if not len(at):
                raise self.first_fault
            words = "%s: left out %s that cannot be read, the first: %s"
            logger.warning(words, self.path, many(len(self.rows.at) - len(at), "row"), self.first_fault)
        if self.has_commas:
            read_as = "decimal commas were read as points"
            if self.decimal == "point":
                read_as = "commas were read as marks of thousands, not of decimals"
            logger.warning("%s: %s", self.path, read_as)
        return block, np.array(self.rows.numbered(at.tolist()), dtype=np.int64) + 1

    def _piece(self, at: list[int]) -> tuple[Matrix, Indices]:
        """Numbers of some rows, and which of them were kept."""
        lines, mark = [self.rows.lines[i] for i in at], self.rows.delimiter
        block = numbers_at_once(lines, mark, len(self.names), self.places, self.decimal)
        if block is None:
            return self._looked_at(at)
        self.has_commas |= self.decimal == "comma" and any("," in line for line in lines)
        in_units(
            block, lambda k: (line.split(mark, k + 1)[k] for line in lines), self.places, self.decimal, self.digits
        )
        return block, np.array(at)

    def _looked_at(self, at: list[int]) -> tuple[Matrix, Indices]:
        """Numbers of rows cell by cell; halves where one cannot be read, which lead to it, and past it."""
        lines, numbers = [self.rows.lines[i] for i in at], self.rows.numbered(at)
        is_last = self.rows.numbers is None and at[-1] == len(self.rows.lines) - 1
        try:
            cells = cells_of(self.path, lines, numbers, self.rows.delimiter, self.names, is_last=is_last)
            for name in self.clocks:
                if put_seconds(cells, self.places[name], self.decimal):
                    self.digits = {other: n for other, n in self.digits.items() if other != name}
            block = numbers_of(self.path, numbers, cells, self.places, self.decimal, self.digits)
        except DataFormatError as error:
            if len(at) > 1:
                halves = [self._looked_at(half) for half in (at[: len(at) // 2], at[len(at) // 2 :])]
                return np.concatenate([part for part, _ in halves]), np.concatenate([part for _, part in halves])
            if self.recover:
                self.first_fault = self.first_fault or error
                return np.zeros((0, len(self.places))), np.zeros(0, np.int64)
            if self.recover is None or isinstance(error, ForeignNumberError):
                raise
            message = error.message + RECOVER
            raise DataFormatError(self.path, message, line=error.line, column=error.column) from None
        self.has_commas |= any("," in row[k] for row in cells for k in self.places.values())
        return block, np.array(at)


def write_table(
    path: str | Path, columns: Mapping[str, Scalars | list[str]], texts: Mapping[str, str] | None = None
) -> None:
    """Write columns of numbers or words as CSV, and words that are the same in all rows; numbers read back the same.

    The latter stand behind the numbers and not in a comment, so that any other reader of CSV takes the file as it is.
    """
    with atomic_write(path) as stream:
        stream.writelines(_rows(columns, texts or {}))


def _rows(columns: Mapping[str, Scalars | list[str]], texts: Mapping[str, str]) -> Iterator[bytes]:
    """Encode a table piece by piece."""
    yield (",".join([*columns, *texts]) + "\n").encode()
    end = "".join(f",{_quoted(text)}" for text in texts.values()) + "\n"
    n = len(next(iter(columns.values())))
    for start in range(0, n, CHUNK_ROWS):
        cells = [_cells(column[start : start + CHUNK_ROWS]) for column in columns.values()]
        yield "".join(",".join(row) + end for row in zip(*cells, strict=True)).encode()


def _cells(column: Scalars | list[str]) -> list[str]:
    return list(map(_quoted, column)) if isinstance(column, list) else exact(column)


def _quoted(text: str) -> str:
    """A cell of a CSV row; rows are lines, so line ends within the text are not for us."""
    return '"' + text.replace('"', '""') + '"' if set(text) & set(',"') else text
