# SPDX-License-Identifier: BSD-3-Clause
"""Rows of numbers of several sensors in one text, each row named after its sensor; the first number is its time."""

import re
from collections.abc import Iterable, Sequence
from pathlib import Path

import numpy as np

from magmatch.data.tables.number_marks import Decimal, decimal_of_cells
from magmatch.data.tables.numbers import NumberReader
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
    held = [(line, [tag, *cells]) for line, tag, cells in rows]
    if not held:
        return {}
    mark = decimal_of_cells(path, ((line, cells[1:]) for line, cells in held), names, decimal)
    places = {name: k for k, name in enumerate(names, start=1)}
    reader = NumberReader(
        path, ("sensor", *names), places, mark, {names[0]: digits}, words={"sensor": 0}, recover=recover
    )
    block, lines, words = reader.read(held)
    tags = np.array(words["sensor"])
    return {tag: (block[tags == tag], lines[tags == tag]) for tag in dict.fromkeys(words["sensor"])}
