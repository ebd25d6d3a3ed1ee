# SPDX-License-Identifier: BSD-3-Clause
"""Numbers of rows of cells: a fault says line and column; faulty rows can be left out and counted."""

import logging
from array import array
from collections.abc import Collection, Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from math import isfinite
from pathlib import Path

import numpy as np

from magmatch.data.tables.number_marks import Decimal, is_number, number_of_text
from magmatch.data.tables.text_rows import listed
from magmatch.data.tables.times import seconds_of_date, seconds_of_text
from magmatch.errors import DataFormatError
from magmatch.number_text import many
from magmatch.typing import Indices, Matrix

logger = logging.getLogger(__name__)

RECOVER = "; --recover leaves such rows out"


class ForeignNumberError(DataFormatError):
    """A row holds numbers, but written in a way that is not read: no damage, and not to be left out."""


@dataclass(slots=True)
class NumberReader:
    """Reads the numbers of rows of cells."""

    path: str | Path
    names: Sequence[str]  # of all columns
    places: Mapping[str, int]  # of the wanted columns
    decimal: Decimal = "point"
    # Columns that count units of 10**-digits; read in whole units, rounded once.
    digits: Mapping[str, int] = field(default_factory=dict)
    clocks: Collection[str] = ()  # columns that may hold dates
    words: Mapping[str, int] = field(default_factory=dict)  # places of columns of words
    recover: bool | None = None  # whether faulty rows are left out; None: there is no such choice
    delimiter: str | None = None  # between cells
    last_line: int | None = None  # of the file
    _first_fault: DataFormatError | None = None
    _n_faults: int = 0
    _has_commas: bool = False  # within numbers

    def read(self, rows: Iterable[tuple[int, list[str]]]) -> tuple[Matrix, Indices, dict[str, list[str]]]:
        """Wanted numbers of rows (line, cells), (n, k), the lines of those that were kept, and their words."""
        numbers, lines, words = array("d"), array("q"), {name: list[str]() for name in self.words}
        for line, cells in rows:
            try:
                self._require_width(line, cells)
                numbers.extend(self._values(line, cells))
            except DataFormatError as error:
                self._refuse_header(line, cells)
                self._leave_out(error)
                continue
            lines.append(line)
            for name, k in self.words.items():
                words[name].append(cells[k].strip())
        if self._first_fault is not None:
            if not len(lines):
                raise self._first_fault
            left_out = many(self._n_faults, "row")
            logger.warning(
                "%s: left out %s that cannot be read, the first: %s", self.path, left_out, self._first_fault
            )
        if self._has_commas:
            is_point = self.decimal == "point"
            read_as = "read as marks of thousands, not of decimals" if is_point else "read as points"
            logger.warning("%s: %scommas were %s", self.path, "" if is_point else "decimal ", read_as)
        return np.array(numbers).reshape(-1, len(self.places)), np.array(lines, dtype=np.int64), words

    def _refuse_header(self, line: int, cells: Sequence[str]) -> None:
        """Refuse a row that repeats the header: another table begins there, unless times show that one goes on."""
        if [cell.strip().strip("'\"").lower() for cell in cells] == list(self.names):
            has_times = bool(self.places.keys() & set(self.clocks))
            if self.recover and has_times:
                return
            message = "repeats the header: two tables, one after the other; split the file before this line"
            message += RECOVER + " of one recording" if has_times else ""
            raise DataFormatError(self.path, message, line=line)

    def _leave_out(self, error: DataFormatError) -> None:
        """Count a faulty row where recovering; refuse it elsewhere."""
        if self.recover:
            self._first_fault, self._n_faults = self._first_fault or error, self._n_faults + 1
        elif self.recover is None or isinstance(error, ForeignNumberError):
            raise error
        else:
            raise DataFormatError(self.path, error.message + RECOVER, line=error.line, column=error.column) from None

    def _require_width(self, line: int, cells: list[str]) -> None:
        """Refuse a row of more or fewer cells than there are columns; empty ones at its end do not count."""
        width = len(self.names)
        while len(cells) > width and not cells[-1].strip():
            cells.pop()
        if len(cells) == width:
            return
        message = f"expected {width} cells ({listed(self.names)}), found {len(cells)}"
        if line == self.last_line and len(cells) < width:
            message += "; the file ends in the middle of this line: cut off?"
        if self.delimiter == "," and len(cells) > width and all(map(is_number, cells)):
            advice = "numbers that hold commas need quotes, or semicolons between the cells; row numbers need a name"
            raise ForeignNumberError(self.path, f"{message}; {advice}", line=line)
        if len(cells) == width + 1:
            message += "; row names or numbers need a name in the header too"
        raise DataFormatError(self.path, message, line=line)

    def _values(self, line: int, cells: Sequence[str]) -> list[float]:
        """Wanted numbers of a row; most are plain, and those Python reads at once."""
        texts = [cells[k] for k in self.places.values()]
        if self.decimal == "comma":
            texts = ["" if "." in text else text.replace(",", ".") for text in texts]
        try:
            # An underscore is no part of a number, but for Python's own.
            values = [np.nan] if "_" in "".join(texts) else [float(text) for text in texts]
        except ValueError:
            values = [np.nan]
        if not isfinite(sum(values)):
            return [self._value(line, name, cells[k]) for name, k in self.places.items()]
        if self.decimal == "comma" and not self._has_commas:
            self._has_commas = any("," in cells[k] for k in self.places.values())
        for k, name in enumerate(self.places if self.digits else ()):
            if self.digits.get(name):
                values[k] = seconds_of_text(cells[self.places[name]], self.digits[name], self.decimal)
        return values

    def _value(self, line: int, name: str, cell: str) -> float:
        """The finite number in a cell; DataFormatError says what is there instead."""
        if name in self.clocks and (seconds := seconds_of_date(cell)) is not None:
            return seconds
        text = cell.strip()
        if not text:
            raise DataFormatError(self.path, "expected a number, found an empty cell", line=line, column=name)
        try:
            value = number_of_text(text, self.decimal)
        except ValueError:
            kind, hint = _advice_on(text, self.decimal)
            message = f"expected a number, found {text[:40]!r}{hint}"
            raise kind(self.path, message, line=line, column=name) from None
        if not isfinite(value):
            message = f"expected a finite number, found {text[:40]!r}; remove the row or repair it"
            raise DataFormatError(self.path, message, line=line, column=name)
        self._has_commas |= "," in cell
        return seconds_of_text(text, self.digits[name], self.decimal) if self.digits.get(name) else value


def _advice_on(text: str, decimal: Decimal) -> tuple[type[DataFormatError], str]:
    """Advise about a cell that is no number; rows of digits are no damage."""
    if text.count(":") > 1:
        return ForeignNumberError, " (times are numbers, or dates such as 2024-05-01T10:00:00.25+02:00)"
    if is_number(text):
        others = "points" if decimal == "point" else "commas"
        return ForeignNumberError, f", where other numbers have decimal {others} (write all decimals with a point)"
    if not text.startswith("#") and any(character.isdigit() for character in text):  # "#DIV/0!" is none
        return ForeignNumberError, " (write it without unit, brackets or other signs, such as -1234.5)"
    return DataFormatError, ""
