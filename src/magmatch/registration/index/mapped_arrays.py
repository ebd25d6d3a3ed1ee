# SPDX-License-Identifier: BSD-3-Clause
"""Memory-mapped arrays in one file: the cost of opening does not depend on their size.

Layout: 16 bytes ``magmatch.arrays``, SHA-256 of the header (32 bytes), its length (8 bytes, little-endian), the
header (JSON: schema, attributes, and dtype, shape and offset of each array), then the arrays, little-endian, each at
a multiple of 64 bytes. The header's own hash is checked on opening, that of the arrays by `MappedArrays.check`.
"""

import hashlib
import json
import math
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from magmatch.atomic import atomic_write
from magmatch.errors import DataFormatError

MAGIC = b"magmatch.arrays\n"
PREFIX = len(MAGIC) + 32 + 8
ALIGNMENT = 64
MAX_HEADER = 1 << 20
DTYPES = {"<f8", "<f4", "<i8", "<i4"}


@dataclass(frozen=True, eq=False, slots=True)
class MappedArrays:
    """An open file of arrays."""

    path: Path
    attributes: dict[str, Any]  # what JSON can hold
    arrays: dict[str, np.ndarray]  # read-only views of the file
    sha256: str  # hash of the arrays' bytes when they were written

    def check(self) -> None:
        """Raise DataFormatError unless the arrays are as they were written; reads all of them."""
        if _digest(self.arrays) != self.sha256:
            raise DataFormatError(self.path, "its arrays are not what was written (damaged or changed)")


def write_mapped(
    path: str | Path, schema: str, attributes: Mapping[str, Any], arrays: Mapping[str, np.ndarray]
) -> None:
    """Write arrays and attributes to one file atomically."""
    held = {name: np.ascontiguousarray(a, dtype=a.dtype.newbyteorder("<")) for name, a in arrays.items()}
    listing, offset = {}, 0
    for name, array in held.items():
        listing[name] = {"dtype": array.dtype.str, "shape": list(array.shape), "offset": offset}
        offset += array.nbytes + -array.nbytes % ALIGNMENT
    about = {"schema": schema, "attributes": dict(attributes), "arrays": listing, "sha256": _digest(held)}
    header = json.dumps(about, allow_nan=False).encode()
    header += b" " * (-(PREFIX + len(header)) % ALIGNMENT)
    with atomic_write(path) as stream:
        stream.write(MAGIC + hashlib.sha256(header).digest() + len(header).to_bytes(8, "little") + header)
        for array in held.values():
            stream.write(array.tobytes() + bytes(-array.nbytes % ALIGNMENT))


def open_mapped(path: str | Path, schema: str) -> MappedArrays:
    """Open a file that `write_mapped` wrote."""
    path = Path(path)
    try:
        about, start = _read_header(path)
        if about["schema"] != schema:
            raise DataFormatError(path, f"expected schema '{schema}', found {about['schema']!r}")
        data = np.memmap(path, dtype=np.uint8, mode="r", offset=0)
        arrays = {name: _view(data, start, entry) for name, entry in about["arrays"].items()}
        return MappedArrays(path, dict(about["attributes"]), arrays, str(about["sha256"]))
    except OSError as error:
        raise DataFormatError(path, f"cannot be read: {error.strerror or error}") from None
    except (ValueError, KeyError, TypeError, AttributeError) as error:
        if isinstance(error, DataFormatError):
            raise
        raise DataFormatError(path, f"is not a file of arrays: {error}") from None


def _read_header(path: Path) -> tuple[dict[str, Any], int]:
    """Header, and where the arrays begin."""
    with path.open("rb") as stream:
        prefix = stream.read(PREFIX)
        length = int.from_bytes(prefix[-8:], "little")
        if not prefix.startswith(MAGIC) or len(prefix) < PREFIX or length > MAX_HEADER:
            raise DataFormatError(path, "is not a file of arrays")
        header = stream.read(length)
    if hashlib.sha256(header).digest() != prefix[len(MAGIC) : -8]:
        raise DataFormatError(path, "its header is damaged or cut off")
    return json.loads(header), PREFIX + length


def _view(data: np.ndarray, start: int, entry: Mapping[str, Any]) -> np.ndarray:
    """One array as a view of the file."""
    if entry["dtype"] not in DTYPES:
        msg = f"dtype {entry['dtype']!r}"
        raise ValueError(msg)
    dtype, shape = np.dtype(entry["dtype"]), tuple(entry["shape"])
    first = start + entry["offset"]
    return np.asarray(data[first : first + dtype.itemsize * math.prod(shape)].view(dtype).reshape(shape))


def _digest(arrays: Mapping[str, np.ndarray]) -> str:
    digest = hashlib.sha256()
    for name, array in arrays.items():
        digest.update(name.encode())
        digest.update(np.ascontiguousarray(array).data)
    return digest.hexdigest()
