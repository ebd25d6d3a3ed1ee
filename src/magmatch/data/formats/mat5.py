# SPDX-License-Identifier: BSD-3-Clause
"""Arrays of MATLAB 5 files. Ours, because SciPy's reader takes Python down with it over damaged ones."""

import math
import struct
import zlib
from collections.abc import Collection, Iterator
from pathlib import Path
from typing import NoReturn

import numpy as np

from magmatch.data.tables.gzipped import most_unpacked
from magmatch.errors import DataFormatError

# Structures within structures, and in one array, that are read; stated in docs/formats.md.
DEEPEST, MOST_STRUCTURES = 8, 1000
_HEADER = 128
_MATRIX, _COMPRESSED = 14, 15
_STRUCTURE, _NUMBERS = 2, range(6, 16)
_COMPLEX = 0x800
_TYPES = {1: "i1", 2: "u1", 3: "i2", 4: "u2", 5: "i4", 6: "u4", 7: "f4", 9: "f8", 12: "i8", 13: "u8"}


class Mat5:
    """A file of variables, read one after the other."""

    def __init__(self, path: Path) -> None:
        self.path = path
        self._limit = most_unpacked(path.stat().st_size)
        self._order = "<"

    def variables(self, wanted: Collection[str] | None) -> Iterator[tuple[str, object]]:
        """Names of all variables and, of those wanted (lower case), what they hold."""
        with self.path.open("rb") as file:
            header = file.read(_HEADER)
            if header[126:128] not in (b"IM", b"MI"):
                self._refuse("its header is cut off or of another version")
            self._order = "<" if header[126:128] == b"IM" else ">"
            while tag := file.read(8):
                if len(tag) < 8:
                    self._refuse("ends within a variable: cut off?")
                kind, size = struct.unpack(self._order + "II", tag)
                data = memoryview(file.read(size))
                if len(data) < size:
                    self._refuse("ends within a variable: cut off?")
                if kind == _COMPRESSED:
                    kind, data = self._element(memoryview(self._expanded(data)), 0)[:2]
                if kind == _MATRIX:
                    name, content = self._matrix(data, 0, wanted)
                    yield name, content

    def _expanded(self, data: memoryview) -> bytes:
        """A compressed variable."""
        unpacker = zlib.decompressobj()
        try:
            expanded = unpacker.decompress(data, self._limit + 1)
        except zlib.error as error:
            self._refuse(str(error))
        self._limit -= len(expanded)
        if self._limit < 0:
            raise DataFormatError(self.path, "its variables unpack to more than such a file may hold: a zip bomb")
        return expanded

    def _element(self, data: memoryview, at: int) -> tuple[int, memoryview, int]:
        """Kind and content of the element at a place, and where the next one is."""
        if len(data) < at + 8:
            self._refuse("a variable ends early")
        kind, size = struct.unpack_from(self._order + "II", data, at)
        if kind >> 16:  # up to four bytes stand in the tag itself
            kind, size, start = kind & 0xFFFF, kind >> 16, at + 4
            if size > 4:
                self._refuse(f"an element of {size} bytes in four")
            after = at + 8
        else:
            start = at + 8
            after = start + -(-size // 8) * 8
        if start + size > len(data):
            self._refuse("a variable ends early")
        return kind, data[start : start + size], after

    def _matrix(self, data: memoryview, depth: int, wanted: Collection[str] | None) -> tuple[str, object]:
        """Name and content of a variable, or of a field."""
        _, flags, at = self._element(data, 0)
        _, dims, at = self._element(data, at)
        _, name, at = self._element(data, at)
        if len(flags) < 4 or len(dims) % 4 or not dims:
            self._refuse("a variable without a shape")
        (flag,) = struct.unpack_from(self._order + "I", flags)
        shape = struct.unpack(f"{self._order}{len(dims) // 4}i", dims)
        if min(shape) < 0:
            self._refuse(f"a variable of {' x '.join(map(str, shape))}")
        title, kind = bytes(name).decode("latin-1"), flag & 0xFF
        if wanted is not None and title.lower() not in wanted:
            return title, None
        if kind in _NUMBERS and not flag & _COMPLEX:
            return title, self._numbers(data, at, shape, title)
        if kind == _STRUCTURE and 1 <= math.prod(shape) <= MOST_STRUCTURES and depth < DEEPEST:
            return title, self._structures(data, at, depth, math.prod(shape))
        return title, None

    def _numbers(self, data: memoryview, at: int, shape: tuple[int, ...], title: str) -> np.ndarray:
        kind, payload, _ = self._element(data, at)
        if kind not in _TYPES:
            self._refuse(f"numbers of an unknown type {kind}", title)
        dtype = np.dtype(self._order + _TYPES[kind])
        if len(payload) != math.prod(shape) * dtype.itemsize:
            found = f"{len(payload)} bytes for {' x '.join(map(str, shape))} numbers"
            self._refuse(f"expected {math.prod(shape) * dtype.itemsize} bytes, found {found}", title)
        return np.frombuffer(payload, dtype).reshape(shape, order="F")

    def _structures(self, data: memoryview, at: int, depth: int, n_structures: int) -> dict[str, object]:
        """Fields of a structure; of several, by their numbers, counted from 1."""
        _, width, at = self._element(data, at)
        _, names, at = self._element(data, at)
        n = int.from_bytes(width, "little" if self._order == "<" else "big")
        if n < 1 or len(names) % n:
            self._refuse("a structure without names of its fields")
        structures: list[dict[str, object]] = []
        for _ in range(n_structures):
            structures.append(fields := {})
            for start in range(0, len(names), n):
                kind, field, at = self._element(data, at)
                title = bytes(names[start : start + n]).partition(b"\0")[0].decode("latin-1")
                fields[title] = self._matrix(field, depth + 1, None)[1] if kind == _MATRIX and len(field) else None
        return structures[0] if n_structures == 1 else {str(k): one for k, one in enumerate(structures, start=1)}

    def _refuse(self, words: str, column: str | None = None) -> NoReturn:
        raise DataFormatError(self.path, f"is a damaged MATLAB file: {words}", column=column) from None
