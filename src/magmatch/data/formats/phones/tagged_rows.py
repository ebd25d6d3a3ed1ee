# SPDX-License-Identifier: BSD-3-Clause
"""Rows of numbers of several sensors in one text, each row named after its sensor; the first number is its time."""

import re
from collections.abc import Iterable, Sequence
from pathlib import Path

from magmatch.data.tables.number_marks import Decimal
from magmatch.data.tables.table import Wanted, read_table
from magmatch.typing import Indices, Matrix

# A row: the line it stands on, counted from 1, its sensor, and a cell for each of the names.
Row = tuple[int, str, Sequence[str]]


def lines_of(raw: bytes) -> list[str]:
    """Lines of a log: UTF-8, or plain ASCII rows below a header of whatever the phone's language writes."""
    try:
        text = raw.decode("utf-8-sig")
    except UnicodeDecodeError:
        text = raw.decode("latin-1")
    return re.split("\r\n?|\n", text)


def read_tagged(
    path: Path, rows: Iterable[Row], names: Sequence[str], digits: int = 0, *, decimal: Decimal | None, recover: bool
) -> dict[str, tuple[Matrix, Indices]]:
    """Read the numbers of each sensor of which there are rows, (n, k), and the lines they stand on.

    Times count units of 10**-digits s. `decimal` counts where the numbers leave their decimal mark in doubt. A faulty
    row is named, or left out and counted where recovering.
    """
    held = list(rows)
    if not held:
        return {}
    tags = list(dict.fromkeys(tag for _, tag, _ in held))
    lines = ["\t".join([str(tags.index(tag)), *cells]) for _, tag, cells in held]
    columns = ("sensor", *names)
    wanted = Wanted(columns, columns, "\t", decimal=decimal, digits={names[0]: digits}, recover=recover)
    table = read_table(path, wanted, lines, [number - 1 for number, _, _ in held])
    block = table.stack(*names)
    of = {tag: table.columns["sensor"] == k for k, tag in enumerate(tags)}
    return {tag: (block[here], table.line_numbers[here]) for tag, here in of.items() if here.any()}
