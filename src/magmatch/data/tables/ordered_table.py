# SPDX-License-Identifier: BSD-3-Clause
"""Tables whose columns have a usual order, such as trajectories: a header, or a comment that is one, comes first."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

from magmatch.data.tables.header_names import Header, header_of, length_unit_of, words_of
from magmatch.data.tables.number_marks import is_number
from magmatch.data.tables.table import Table, read_table
from magmatch.data.tables.text import text_blocks
from magmatch.data.tables.text_rows import delimiter_of, is_row, listed, split_header, stated_delimiter
from magmatch.data.units import DIGITS_OF_SECOND, LengthUnit, TimeUnit
from magmatch.errors import DataFormatError


@dataclass(frozen=True, slots=True)
class _Top:
    """The first row of a table, and the comments above it."""

    comments: tuple[str, ...]
    cells: tuple[str, ...]
    line: int


def read_ordered(
    path: str | Path,
    order: Sequence[str],
    time_unit: TimeUnit = "s",
    length_unit: LengthUnit = "m",
    lone: str = "",
    *,
    recover: bool | None = None,
) -> tuple[Table, TimeUnit]:
    """Read the columns that `order` names, times in s; also gives the unit that the times had in the file.

    Columns are found by the names in a header row, or in a comment above the first row; else they are taken in
    `order`. A header that names another order only in part is refused. Units are as stated here, unless the header
    states that of the times; `lone` as in `header_of`.
    """
    top = _top_of(path)
    if top is None:
        return read_table(path, order, order, recover=recover), time_unit  # which says what is wrong
    is_header_row = not any(map(is_number, top.cells))
    header = _header_row(path, top, order, lone) if is_header_row else _comment(path, top, order, lone)
    units: Mapping[str, str] = header.units if header else {}
    unit = next((unit for unit in DIGITS_OF_SECOND if unit == units.get("t")), time_unit)
    stated = length_unit_of(header) if header else None
    if stated not in (None, "m", length_unit):
        message = f"expected positions in {length_unit}, found '{stated}' in the header: --length-unit {stated}"
        raise DataFormatError(path, message)
    if header and is_header_row:
        ours = {word.lower(): name for word, name in zip(header.words, header.names, strict=True) if name in order}
        clock = next(word for word, name in ours.items() if name == "t")
        table = read_table(path, ours, digits={clock: DIGITS_OF_SECOND[unit]}, recover=recover).renamed(ours)
    else:
        if len(top.cells) < len(order):
            found = f"expected rows of {', '.join(order)}; found {len(top.cells)} cells"
            raise DataFormatError(path, found, line=top.line)
        names = header.names if header and header.names_all(order) else tuple(order)
        rest = tuple(f"column {k + 1}" for k in range(len(names), len(top.cells)))
        table = read_table(path, order, (*names, *rest), digits={"t": DIGITS_OF_SECOND[unit]}, recover=recover)
    table.require_increasing("t")
    return table, unit


def _top_of(path: str | Path) -> _Top | None:
    """What stands first in a table; None where it has no rows."""
    comments: list[str] = []
    mark = None
    for block in text_blocks(path):
        for i, line in enumerate(block.lines, start=block.start + 1):
            if not is_row(line):
                comments.append(line.strip().lstrip("#").strip())
            elif mark is None and (found := stated_delimiter(line)):
                mark = found
            else:
                cells = split_header(line, mark if mark and mark in line else delimiter_of(path, line, i))
                while cells and not cells[-1].strip():
                    cells.pop()
                return _Top(tuple(comments), tuple(cell.strip().strip("'\"") for cell in cells), i)
    return None


def _header_row(path: str | Path, top: _Top, order: Sequence[str], lone: str) -> Header:
    """Names in the first row."""
    header = _read_names(top.cells, order, lone)
    if not header.names_all(order):
        missing = ", ".join(name for name in order if name not in header.names)
        what = f"missing {missing}" if missing else "some are named twice"
        message = f"expected columns {', '.join(order)}; {what}; found {listed(top.cells)}"
        raise DataFormatError(path, f"{message}. Name them in the header as expected", line=top.line)
    return header


def _comment(path: str | Path, top: _Top, order: Sequence[str], lone: str) -> Header | None:
    """Names in a comment, if one names the columns; refused where it says they stand otherwise, but not how."""
    n = len(top.cells)
    for comment in reversed(top.comments):
        words = words_of(comment)
        for start in range(max(1, len(words) - n + 1)):  # words such as "format:" may stand before the names
            header = _read_names(words[start : start + n], order, lone)
            if header.names_all(order):
                return header
        header = _read_names(words, order, lone)
        if len(order) - 1 <= len(words) <= n and 2 * sum(map(bool, header.names[: len(order)])) >= len(order):
            if disagreement := header.against(order):
                advice = f"name all columns in the comment ({' '.join(order)}), or remove it if they stand so"
                raise DataFormatError(path, f"in the comment '{comment[:60]}' {disagreement}; {advice}")
            return header
    return None


def _read_names(words: Sequence[str], order: Sequence[str], lone: str) -> Header:
    """Names of columns; axes without a word before them only count where there are none with one."""
    header = header_of(words)
    return header if header.names_all(order) else header_of(words, lone)
