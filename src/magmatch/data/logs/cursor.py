# SPDX-License-Identifier: BSD-3-Clause
"""Reads many serialised messages of one length side by side: field after field, all rows at once."""

import numpy as np
from jaxtyping import UInt8

Rows = UInt8[np.ndarray, "k n"]


class UnevenError(Exception):
    """Rows differ in something that decides where the next field stands; split them by it and begin again."""

    def __init__(self, values: np.ndarray) -> None:
        super().__init__("rows differ in their layout")
        self.values = values


class MalformedError(Exception):
    """These bytes are no message of the expected type."""


class Cursor:
    """A place in many messages of one length at once.

    Parameters
    ----------
    rows : (k, n) uint8 array
        Payloads.
    encoding : str
        ``ros1`` (packed, little-endian) or ``cdr`` (aligned, byte order stated by four bytes in front).
    """

    def __init__(self, rows: Rows, encoding: str) -> None:
        self._rows, self.encoding = rows, encoding
        self._at = self._origin = 0
        self._order = "<"
        if encoding == "cdr":
            kind = self.numbers("u1", 4)
            if (kind[:, 1] != kind[0, 1]).any():
                raise UnevenError(kind[:, 1])
            if kind[0, 0] or kind[0, 1] > 1:
                msg = f"expected plain CDR, found representation {kind[0, 0]:#04x} {kind[0, 1]:#04x}"
                raise MalformedError(msg)
            self._order = "<" if kind[0, 1] else ">"
            self._origin = 4

    def __len__(self) -> int:
        return len(self._rows)

    @property
    def rest(self) -> int:
        """Bytes not read yet."""
        return int(self._rows.shape[1]) - self._at

    def numbers(self, kind: str, n: int) -> np.ndarray:
        """Next numbers, (k, n), of a NumPy type such as ``f8``."""
        size = np.dtype(kind).itemsize
        if self.encoding == "cdr" and n:  # what is empty is not aligned
            self._at += -(self._at - self._origin) % size
        return np.ascontiguousarray(self._take(n * size)).view(self._order + kind)

    def count(self) -> int:
        """Next unsigned number, which decides what follows and so must be the same in all rows."""
        values = self.numbers("u4", 1)[:, 0]
        first = int(values[0])
        if (values != first).any():
            raise UnevenError(values)
        return first

    def text(self) -> np.ndarray:
        """Next string of each row, as (k,) bytes."""
        n = self.count()
        raw = np.ascontiguousarray(self._take(n))
        return raw.view(f"S{n}")[:, 0] if n else np.zeros(len(self), "S1")

    def _take(self, n: int) -> Rows:
        if n > self.rest:
            msg = f"a field of {n} bytes where {max(self.rest, 0)} are left"
            raise MalformedError(msg)
        part = self._rows[:, self._at : self._at + n]
        self._at += n
        return part
