# SPDX-License-Identifier: BSD-3-Clause
"""The parts of a variable in a MATLAB file of version 5: SciPy reads numbers of no known type outside its memory."""

import struct
import zlib
from pathlib import Path

# Types of parts, and classes of variables: MathWorks, "MAT-File Format", tables 1-1 and 1-3.
MATRIX, COMPRESSED = 14, 15
NUMBERS = frozenset({1, 2, 3, 4, 5, 6, 7, 9, 12, 13, 16, 17, 18})
FLAGS = (6, 8)  # type and bytes of the first part
SPARSE, ARRAYS, IS_COMPLEX = 5, range(6, 16), 0x800
HEADER, HEAD = 128, 4096  # bytes: of the file; of a variable, enough to tell its name


def require_parts(path: Path, name: str) -> None:
    """Require that the variables of a name consist of the parts that their class has, of known types."""
    data = memoryview(path.read_bytes())
    order = "<" if bytes(data[126:128]) == b"IM" else ">"
    for kind, part in _parts(data[HEADER:], order):
        is_packed = kind == COMPRESSED
        head = zlib.decompressobj().decompress(part, HEAD) if is_packed else part[:HEAD]
        if _name(memoryview(head)[8 if is_packed else 0 :], order) == name.encode("latin1"):
            whole = _parts(memoryview(zlib.decompress(part)), order) if is_packed else [(kind, part)]
            for inner_kind, inner in whole:
                _require(inner_kind, inner, order)


def _parts(data: memoryview, order: str) -> list[tuple[int, memoryview]]:
    """Type and content of each part."""
    found, at = [], 0
    while at + 8 <= len(data):
        kind, size = struct.unpack_from(f"{order}II", data, at)
        begin, end = at + 8, at + 8 + size
        if kind >> 16:  # a few bytes beside their tag
            kind, begin, end = kind & 0xFFFF, at + 4, at + 4 + min(kind >> 16, 4)
        found.append((kind, data[begin:end]))
        at = end if kind == COMPRESSED else end + -end % 8
    return found


def _name(head: memoryview, order: str) -> bytes:
    """Name of a variable from its beginning."""
    parts = _parts(head, order)
    return bytes(parts[2][1]) if len(parts) > 2 else b""


def _require(kind: int, content: memoryview, order: str) -> None:
    if kind != MATRIX:
        if kind not in NUMBERS:
            msg = f"a part of unknown type {kind}"
            raise ValueError(msg)
        return
    parts = _parts(content, order)
    if not parts:
        return  # an empty one
    if (parts[0][0], len(parts[0][1])) != FLAGS:
        msg = "a variable that does not begin with its flags"
        raise ValueError(msg)
    (flags,) = struct.unpack_from(f"{order}I", parts[0][1])
    has = {SPARSE: 6} | dict.fromkeys(ARRAYS, 4)
    expected = has.get(flags & 0xFF, 0) + bool(flags & IS_COMPLEX)
    if flags & 0xFF in has and len(parts) != expected:
        msg = f"{len(parts)} parts of an array, expected {expected}"
        raise ValueError(msg)
    for part in parts:
        _require(*part, order)
