# SPDX-License-Identifier: BSD-3-Clause
"""Rows of numbers of several sensors in one text, each row named after its sensor; the first number is its time."""

import logging
import re
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from magmatch.data.tables.number_marks import Decimal, number_of_text
from magmatch.data.tables.text_rows import RECOVER, ForeignNumberError, advice_on
from magmatch.errors import DataFormatError
from magmatch.number_text import many
from magmatch.typing import Indices, Matrix

logger = logging.getLogger(__name__)


def lines_of(raw: bytes) -> list[str]:
    """Lines of a log: UTF-8, or plain ASCII rows below a header of whatever the phone's language writes."""
    try:
        text = raw.decode("utf-8-sig")
    except UnicodeDecodeError:
        text = raw.decode("latin-1")
    return re.split("\r\n?|\n", text)


class TaggedRows:
    """Collects the rows of each sensor; a faulty one is named, or left out and counted where recovering."""

    def __init__(self, path: Path, names: Sequence[str], decimal: Decimal, *, recover: bool) -> None:
        self.path, self.names, self.decimal, self.recover = path, tuple(names), decimal, recover
        self.times: dict[str, list[float]] = {}  # by sensor; whole numbers as they are, beyond what float64 holds
        self._rows: dict[str, list[list[float]]] = {}
        self._lines: dict[str, list[int]] = {}
        self._n_faults = 0

    def take(self, tag: str, line: int, cells: Sequence[str]) -> None:
        """Add a row: one cell for each of the names."""
        try:
            numbers = [number_of_text(cell, self.decimal) for cell in cells]
        except ValueError:
            numbers = []
        if len(numbers) != len(self.names) or not np.isfinite(numbers).all():
            if not self.recover:
                raise self._fault(line, cells)
            self._n_faults += 1
            return
        time = cells[0].strip()
        self.times.setdefault(tag, []).append(int(time) if time.isdecimal() else numbers[0])
        self._rows.setdefault(tag, []).append(numbers)
        self._lines.setdefault(tag, []).append(line)

    def blocks(self) -> dict[str, tuple[Matrix, Indices]]:
        """Numbers of each sensor of which there are rows, (n, k), and the lines they stand on."""
        if self._rows and self._n_faults:
            logger.warning("%s: left out %s that cannot be read", self.path, many(self._n_faults, "row"))
        return {tag: (np.array(rows), np.array(self._lines[tag], dtype=np.int64)) for tag, rows in self._rows.items()}

    def _fault(self, line: int, cells: Sequence[str]) -> DataFormatError:
        """What is wrong with a row."""
        advice = RECOVER
        if len(cells) != len(self.names):
            message = f"expected {len(self.names)} numbers ({', '.join(self.names)}), found {len(cells)}{advice}"
            return DataFormatError(self.path, message, line=line)
        for name, cell in zip(self.names, cells, strict=True):
            try:
                is_finite = bool(np.isfinite(number_of_text(cell, self.decimal)))
            except ValueError:
                is_finite = False
                kind, hint = advice_on(cell.strip(), self.decimal)
                advice = hint if kind is ForeignNumberError else hint + RECOVER
            if not is_finite:
                message = f"expected a finite number, found {cell.strip()[:40]!r}{advice}"
                return DataFormatError(self.path, message, line=line, column=name)
        msg = "a fault was reported but none found"
        raise AssertionError(msg)
