# SPDX-License-Identifier: BSD-3-Clause
"""Checks of an archive's structure, before anything in it is used."""

import json
import math
import re
import zipfile
from collections.abc import Mapping
from itertools import product
from pathlib import Path
from typing import Any, TypeGuard

from magmatch.errors import DataFormatError

MAX_BYTES = 2 * 1024**3
MAX_ENTRIES = 100_000
MAX_JSON_BYTES = 16 * 1024**2
CODECS = [{"name": "bytes", "configuration": {"endian": "little"}}, {"name": "crc32c"}]
CHUNK_KEYS = {"name": "default", "configuration": {"separator": "/"}}
CRC_BYTES = 4
END_BYTES = 22
ARRAY_NAME = r"[a-z_]+(?:\.-?[0-9]{1,9}){0,3}"
ENTRY_NAME = re.compile(rf"(?:{ARRAY_NAME}/)?zarr\.json|{ARRAY_NAME}/c(?:/[0-9]{{1,9}}){{1,3}}")


def check_outside(path: str | Path, content: bytes) -> None:
    """Size and both ends of the file, before anything in it is believed."""
    if len(content) > MAX_BYTES:
        raise DataFormatError(path, f"is larger than any saved map ({MAX_BYTES} bytes)")
    if not content.startswith(b"PK\x03\x04"):
        raise DataFormatError(path, "is not a saved map (expected a zip archive)")
    tail = content[-END_BYTES:]
    # A fixed-length end record without comment; a large directory would cost memory before it can be checked.
    if not tail.startswith(b"PK\x05\x06") or int.from_bytes(tail[12:16], "little") > MAX_ENTRIES * 200:
        raise DataFormatError(path, "has no zip directory at its end (cut off while writing or copying?)")


def check_entry(path: str | Path, info: zipfile.ZipInfo) -> None:
    """A name that we write, and stored as it is: nothing to unpack, nowhere else to go."""
    if not ENTRY_NAME.fullmatch(info.filename):
        raise DataFormatError(path, f"holds an entry that no map has: {info.filename[:60]!r}")
    if info.compress_type != zipfile.ZIP_STORED or info.file_size != info.compress_size or info.flag_bits & 1:
        raise DataFormatError(path, f"entry '{info.filename}' is compressed or encrypted, expected plain")
    if info.file_size > MAX_BYTES or (info.filename.endswith(".json") and info.file_size > MAX_JSON_BYTES):
        raise DataFormatError(path, f"entry '{info.filename}' is too large: {info.file_size} bytes")


def parse(path: str | Path, name: str, content: bytes) -> dict[str, Any]:
    """Parse a JSON object."""
    try:
        parsed = json.loads(content)
    except (ValueError, RecursionError) as error:
        raise DataFormatError(path, f"entry '{name}' is not JSON: {one_line(error)}") from None
    if not isinstance(parsed, dict):
        raise DataFormatError(path, f"entry '{name}': expected a JSON object, found {type(parsed).__name__}")
    return parsed


def check_array(path: str | Path, name: str, entries: Mapping[str, bytes]) -> None:
    """Float64 with our codecs alone, and every chunk of the declared shape there in full length."""
    about = entries.get(f"{name}/zarr.json")
    if about is None:
        raise DataFormatError(path, f"entry '{name}/zarr.json' is missing")
    meta = parse(path, f"{name}/zarr.json", about)
    where = f"entry '{name}/zarr.json'"
    if meta.get("node_type") != "array" or meta.get("data_type") != "float64" or meta.get("codecs") != CODECS:
        raise DataFormatError(path, f"{where}: expected a float64 array with codecs bytes and crc32c")
    if meta.get("chunk_key_encoding") != CHUNK_KEYS or meta.get("storage_transformers"):
        raise DataFormatError(path, f"{where}: expected chunks named 'c/0/0' and stored as they are")
    shape, grid = meta.get("shape"), meta.get("chunk_grid")
    chunk = look_into(grid, "configuration", "chunk_shape") if look_into(grid, "name") == "regular" else None
    if not _is_shape(shape) or not _is_shape(chunk) or len(shape) != len(chunk) or 0 in chunk:
        raise DataFormatError(path, f"{where}: expected a shape of 1 to 3 numbers and one of its chunks")
    n_chunks = [-(-n // c) for n, c in zip(shape, chunk, strict=True)]
    held = {n for n in entries if n.startswith(f"{name}/c/")}
    if math.prod(n_chunks) != len(held):
        raise DataFormatError(path, f"{where}: expected {math.prod(n_chunks)} chunks, found {len(held)}")
    # Of an empty array another axis may be declared of any length, which `product` would write out first.
    for index in product(*map(range, n_chunks)) if held else ():
        key = f"{name}/c/" + "/".join(map(str, index))
        if key not in held or len(entries[key]) != math.prod(chunk) * 8 + CRC_BYTES:
            raise DataFormatError(path, f"entry '{key}' is missing or of the wrong length")


def look_into(value: Any, *keys: str) -> Any:
    """Look into nested objects; None where there is nothing."""
    for key in keys:
        value = value.get(key) if isinstance(value, dict) else None
    return value


def _is_shape(value: Any) -> TypeGuard[list[int]]:
    return (
        isinstance(value, list)
        and 1 <= len(value) <= 3
        and all(isinstance(n, int) and not isinstance(n, bool) and 0 <= n <= MAX_BYTES for n in value)
    )


def one_line(error: Exception) -> str:
    """Message of an error in one line."""
    return " ".join(str(error).split())[:200] or type(error).__name__
