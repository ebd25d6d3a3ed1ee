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
from magmatch.data.tables.text import Block, text_blocks
from magmatch.data.tables.text_rows import (
    RECOVER,
    ForeignNumberError,
    cells_of,
    decimal_of_cells,
    delimiter_of,
    in_units,
    is_row,
    listed,
    names_of,
    numbered_names,
    numbers_at_once,
    numbers_of,
    put_seconds,
    split_header,
    split_row,
    stated_delimiter,
)
from magmatch.errors import DataFormatError
from magmatch.number_text import exact, many, told
from magmatch.typing import Indices, Matrix, Scalars

logger = logging.getLogger(__name__)

# Rows turned into numbers at a time: text cells are bulky, so a long log is never held as cells all at once.
CHUNK_ROWS = 20_000
# Comment lines above the first row that are kept.
MAX_COMMENTS = 1000


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


def read_table(
    path: str | Path,
    known: Collection[str],
    names: Sequence[str] | None = None,
    raw: bytes | None = None,
    *,
    recover: bool | None = None,
    advise: Callable[[Sequence[str]], str] = lambda _: "",
    texts: Collection[str] = (),
    choose: Callable[[Sequence[str]], Mapping[str, str]] | None = None,
    numbered: Sequence[int] = (),
    decimal: Decimal | Literal[""] | None = None,
    digits: Mapping[str, int] | None = None,
) -> Table:
    """Read the known columns of a delimited text file; every number is finite, and there is at least one row.

    Lines that start with ``#`` and blank lines are skipped. Cells are split at the delimiter of the header: comma,
    semicolon, tab, or else white space; or the one that a first line ``sep=;`` states. Numbers may have decimal
    commas and groups of three digits; `decimal` says which mark is decimal where the numbers leave that in doubt ("":
    not stated; None where there is no such choice, which messages then do not offer). Columns in `digits`, by our
    names, count units of 10**-digits, such as {"t": 9} of nanoseconds, and are returned in whole units, rounded once.

    Columns that are not known (lower case) are ignored, whatever they hold; `texts` are those that hold one word for
    the whole file. `names` are the columns of formats without a header row, `raw` the content of what is no file of
    its own (a member of an archive). `recover` leaves out rows that cannot be read, and says how many, instead of
    refusing; None where there is no such choice, which messages then do not offer. `advise` says what to do about a
    file that has none of the columns, from the names it has. `choose` picks the columns, {theirs: ours}, from the
    names there are, where names alone do not tell; `numbered` are columns known by number, counted from 1, for which
    no header is needed. Dates (ISO 8601) of times become seconds since 1970.
    """
    reader = _TableReader(path, known, names, raw, recover, advise, texts, choose, numbered, decimal, digits or {})
    for block in text_blocks(path, raw):
        reader.take(block)
    return reader.table()


@dataclass(slots=True)
class _TableReader:
    """Turns a table into numbers block by block; asked for as in `read_table`."""

    path: str | Path
    known: Collection[str]
    names: Sequence[str] | None
    raw: bytes | None
    recover: bool | None
    advise: Callable[[Sequence[str]], str]
    texts: Collection[str]
    choose: Callable[[Sequence[str]], Mapping[str, str]] | None
    numbered: Sequence[int]
    stated: Decimal | Literal[""] | None
    digits: Mapping[str, int]
    chosen: Mapping[str, str] = field(default_factory=dict)
    said: dict[str, str] = field(default_factory=dict)
    first_fault: DataFormatError | None = None
    n_faults: int = 0
    decimal: Decimal = "point"
    has_commas: bool = False  # within numbers
    comments: list[str] = field(default_factory=list)
    has_begun: bool = False
    delimiter: str | None = None
    wanted: dict[str, int] = field(default_factory=dict)
    columns: list[list[Scalars]] = field(default_factory=list)
    line_numbers: list[Indices] = field(default_factory=list)

    def take(self, block: Block) -> None:
        """Read the rows of a block; its first row may be the header."""
        lines = block.lines
        rows = [i for i, line in enumerate(lines) if is_row(line)]
        if not self.has_begun:
            above = lines[: rows[0]] if rows else lines
            self.comments += [line.strip().lstrip("#").strip() for line in above if line.strip()][:MAX_COMMENTS]
            if rows and self.delimiter is None and (mark := stated_delimiter(lines[rows[0]])):
                self.delimiter = mark
                rows.pop(0)
        if rows and not self.has_begun:
            self._begin(lines, rows, block.start)
        if rows and not self.wanted:
            self._choose()
            self._decide(block, rows)
        for start in range(0, len(rows), CHUNK_ROWS):
            chunk = rows[start : start + CHUNK_ROWS]
            is_last = block.is_last and chunk[-1] == len(lines) - 1
            self._take_rows([lines[i] for i in chunk], [block.start + i for i in chunk], is_last=is_last)

    def _begin(self, lines: list[str], rows: list[int], start: int) -> None:
        """Learn delimiter and names from the first row."""
        self.has_begun = True
        first = lines[rows[0]]
        if self.delimiter is None or self.delimiter not in first:
            self.delimiter = delimiter_of(self.path, first, start + rows[0] + 1)
        if self.names is None:
            cells, line, is_header = split_header(first, self.delimiter), start + rows[0] + 1, True
            if self.numbered:
                self.names, is_header = numbered_names(cells, self.numbered)
            else:
                self.names = names_of(self.path, cells, line, self.known, self.comments, self.advise)
            if is_header:
                rows.pop(0)
        self.chosen = {name: name for name in self.known} if self.choose is None else self.choose(self.names)
        self.digits = {name: self.digits[ours] for name, ours in self.chosen.items() if ours in self.digits}

    def _choose(self) -> None:
        """Which columns to read, at the first row of numbers."""
        names = self.names or ()
        self.wanted = {name: k for k, name in enumerate(names) if name in self.chosen}
        if not self.wanted:
            message = f"expected columns such as {listed(tuple(self.known))}; found {listed(names)}"
            advice = self.advise(names)
            raise DataFormatError(self.path, f"{message}. {advice}" if advice else message)
        self.columns = [[] for _ in self.wanted]

    def _decide(self, block: Block, rows: list[int]) -> None:
        """Learn the decimal mark from all numbers, where the first ones leave it in doubt."""
        self.decimal = decimal_of_cells(self.path, self._cells_ahead(block, rows), tuple(self.wanted), self.stated)

    def _cells_ahead(self, block: Block, rows: list[int]) -> Iterator[tuple[int, list[str]]]:
        """Lines and wanted cells of all rows from here on that may hold marks."""
        yield from self._marked_cells(block, rows)
        if not block.is_last:
            for later in text_blocks(self.path, self.raw):
                if later.start > block.start:
                    yield from self._marked_cells(later, [i for i, line in enumerate(later.lines) if is_row(line)])

    def _marked_cells(self, block: Block, rows: list[int]) -> Iterator[tuple[int, list[str]]]:
        lines = block.lines
        if any("." in lines[i] or ("," in lines[i] and (self.delimiter != "," or '"' in lines[i])) for i in rows):
            for i in rows:
                cells = split_row(lines[i], self.delimiter)
                yield block.start + i + 1, [cells[k] for k in self.wanted.values() if k < len(cells)]

    def _take_texts(self, rows: list[str], numbers: list[int]) -> None:
        """Learn the words that all rows share."""
        for name, k in [(name, k) for k, name in enumerate(self.names or ()) if name in self.texts]:
            for i, row in zip(numbers, rows, strict=True):
                found = "".join(split_row(row, self.delimiter)[k : k + 1]).strip()
                if found and self.said.setdefault(name, found) != found:
                    message = (
                        f"found {found[:40]!r} below {self.said[name][:40]!r}; a file holds one survey: split it"
                    )
                    raise DataFormatError(self.path, message, line=i + 1, column=name)

    def _take_rows(self, rows: list[str], numbers: list[int], *, is_last: bool) -> None:
        self._take_texts(rows, numbers)
        block = None
        if self.decimal == "point":
            block = numbers_at_once(rows, self.delimiter, len(self.names or ()), self.wanted)
        if block is None:
            block, numbers = self._looked_at(rows, numbers, is_last=is_last)
        else:
            in_units(
                block,
                lambda k: (row.split(self.delimiter, k + 1)[k] for row in rows),
                self.wanted,
                self.decimal,
                self.digits,
            )
        for parts, values in zip(self.columns, block.T, strict=True):
            parts.append(values.copy())
        self.line_numbers.append(np.array(numbers, dtype=np.int64) + 1)

    def _looked_at(self, rows: list[str], numbers: list[int], *, is_last: bool) -> tuple[Matrix, list[int]]:
        """Numbers of rows cell by cell, and which of the rows were kept."""
        try:
            cells = cells_of(self.path, rows, numbers, self.delimiter, self.names or (), is_last=is_last)
            self._put_seconds(cells)
            self.has_commas |= any("," in row[k] for row in cells for k in self.wanted.values())
            return numbers_of(self.path, numbers, cells, self.wanted, self.decimal, self.digits), numbers
        except DataFormatError as error:
            if self.recover is None:
                raise
            if not self.recover:
                if isinstance(error, ForeignNumberError):
                    raise
                raise DataFormatError(
                    self.path, error.message + RECOVER, line=error.line, column=error.column
                ) from None
            if len(rows) == 1:
                self.first_fault, self.n_faults = self.first_fault or error, self.n_faults + 1
                return np.zeros((0, len(self.wanted))), []
        # Halves, so that few bad rows among many cost little.
        middle = len(rows) // 2
        first, second = (
            self._looked_at(rows[part], numbers[part], is_last=False) for part in (slice(middle), slice(middle, None))
        )
        return np.concatenate([first[0], second[0]]), first[1] + second[1]

    def _put_seconds(self, cells: list[list[str]]) -> None:
        """Write times that are dates as numbers of seconds."""
        for name in [name for name in self.wanted if self.chosen[name] == "t" or name in self.digits]:
            if put_seconds(cells, self.wanted[name], self.decimal):
                self.digits = {other: n for other, n in self.digits.items() if other != name}

    def table(self) -> Table:
        """All that was read."""
        if not self.has_begun:
            raise DataFormatError(self.path, "holds only comments and blank lines, expected rows of numbers")
        if not self.line_numbers:
            raise DataFormatError(self.path, "has a header row but no samples under it")
        if self.first_fault is not None:
            if not any(map(len, self.line_numbers)):
                raise self.first_fault
            logger.warning(
                "%s: left out %s that cannot be read, the first: %s",
                self.path,
                many(self.n_faults, "row"),
                self.first_fault,
            )
        if self.has_commas:
            read_as = "decimal commas were read as points"
            if self.decimal == "point":
                read_as = "commas were read as marks of thousands, not of decimals"
            logger.warning("%s: %s", self.path, read_as)
        columns = {}
        for name in self.wanted:  # one after the other, so that little is there twice
            columns[name] = np.concatenate(self.columns.pop(0))
        numbers = np.concatenate(self.line_numbers)
        return Table(
            Path(self.path), tuple(self.names or ()), columns, numbers, tuple(self.comments), self.said, self.decimal
        )


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
