# SPDX-License-Identifier: BSD-3-Clause
"""Tables whose columns have a usual order, such as trajectories: a header, or a comment that is one, comes first."""

from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np

from magmatch.data.tables.header_names import Header, header_of, words_of
from magmatch.data.tables.motive import is_of_motive, read_motive
from magmatch.data.tables.number_marks import is_number, number_of_text
from magmatch.data.tables.table import Table, Wanted, read_table
from magmatch.data.tables.text import text_lines
from magmatch.data.tables.text_rows import listed, rows_of
from magmatch.data.units import DIGITS_OF_SECOND, METRE_PER_UNIT, LengthUnit, TimeUnit
from magmatch.errors import DataFormatError


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
    lines = text_lines(path)
    if is_of_motive(next(filter(str.strip, lines), "")):
        table = read_motive(path, lines, length_unit, recover=recover)
        table.require_increasing("t")
        return table, "s"
    rows = rows_of(path, lines, lambda _, names: _read_names(names, order, lone).names_all(order))
    if not rows.at:
        return read_table(path, Wanted(order, order), lines), time_unit  # which says what is wrong
    line = rows.at[0] + 1
    cells = rows.header()
    is_header_row = not any(map(is_number, cells))
    header: Header | None
    if is_header_row:
        header = _header_row(path, cells, line, order, lone)
    else:
        header = _comment(path, len(cells), rows.comments, order, lone)
    units: Mapping[str, str] = header.units if header else {}
    unit = next((unit for unit in DIGITS_OF_SECOND if unit == units.get("t")), time_unit)
    lengths = {units.get(name) for name in "xyz"}
    stated = next((unit for unit in METRE_PER_UNIT if unit in lengths), None)
    if stated not in (None, "m", length_unit):
        message = f"expected positions in {length_unit}, found '{stated}' in the header: --length-unit {stated}"
        raise DataFormatError(path, message)
    if header and is_header_row:
        ours = {word.lower(): name for word, name in zip(header.words, header.names, strict=True) if name in order}
        clock = next(word for word, name in ours.items() if name == "t")
        wanted = Wanted(ours, digits={clock: DIGITS_OF_SECOND[unit]}, recover=recover, header_line=line)
        table = read_table(path, wanted, lines).renamed(ours)
    else:
        if len(cells) < len(order):
            found = f"expected rows of {', '.join(order)}; found {len(cells)} cells"
            raise DataFormatError(path, found, line=line)
        if header is None and _is_matrix(cells):
            message = f"12 numbers a row are KITTI poses, which have no times: write rows of {' '.join(order)}"
            raise DataFormatError(path, f"{message}, with the times of their own file (times.txt)", line=line)
        names = header.names if header and header.names_all(order) else tuple(order)
        rest = tuple(f"column {k + 1}" for k in range(len(names), len(cells)))
        wanted = Wanted(order, (*names, *rest), digits={"t": DIGITS_OF_SECOND[unit]}, recover=recover)
        table = read_table(path, wanted, lines)
    table.require_increasing("t")
    return table, unit


def _is_matrix(cells: Sequence[str]) -> bool:
    """Whether a row is a rotation matrix with a translation behind each of its rows: (3, 4)."""
    if len(cells) != 12 or not all(map(is_number, cells)):
        return False
    R = np.array([number_of_text(cell) for cell in cells]).reshape(3, 4)[:, :3]
    return np.allclose(R @ R.T, np.eye(3), atol=1e-3)


def _header_row(path: str | Path, cells: Sequence[str], line: int, order: Sequence[str], lone: str) -> Header:
    """Names in the first row."""
    header = _read_names(cells, order, lone)
    if not header.names_all(order):
        missing = ", ".join(name for name in order if name not in header.names)
        what = f"missing {missing}" if missing else "some are named twice"
        message = f"expected columns {', '.join(order)}; {what}; found {listed(cells)}"
        raise DataFormatError(path, f"{message}. Name them in the header as expected", line=line)
    return header


def _comment(path: str | Path, n: int, comments: Sequence[str], order: Sequence[str], lone: str) -> Header | None:
    """Names in a comment, if one names the columns; refused where it says they stand otherwise, but not how."""
    for comment in reversed(comments):
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
