# SPDX-License-Identifier: BSD-3-Clause
"""The one container of what the program saves: a tree of numbers, words and arrays in one checked file.

    save("hall.map", "magmatch.map/3", {"name": "hall", "surveys": [{"positions": positions}]})
    load("hall.map", "magmatch.map/3")["surveys"][0]["positions"]

The tree consists of dicts with words as keys, lists, tuples, numbers, words, None, NumPy arrays, a `RigidTransform`
or `Rotation` and, where a reader names them in `kinds`, dataclasses and named tuples. All come back to the bit, an
array that stands in two places as one array. The same tree gives the same bytes; a file is written whole or not at
all, and whatever is damaged in it is one `DataFormatError`.

The layout is that of safetensors, so that other programs read the arrays: the length of the header (8 bytes,
little-endian), the header (JSON), the arrays (C order, little-endian) without gaps. The header begins with the
SHA-256 of the rest of it, which holds the SHA-256 of the arrays; so the first one stands for the whole content. A
file holds nothing that is run or unpacked, and never asks for more memory than it is long.
"""

import hashlib
import json
import math
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, fields, is_dataclass
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from pydantic import ValidationError
from scipy.spatial.transform import RigidTransform, Rotation

from magmatch._version import __version__
from magmatch.atomic import atomic_write
from magmatch.data.document import unique_keys
from magmatch.data.formats.sniff import STORED
from magmatch.data.tables.pipes import at_rest
from magmatch.data.tables.text import read_bytes
from magmatch.errors import DataFormatError, first_fault
from magmatch.geometry import ORTHONORMAL_TOLERANCE, transform_from_matrix

MAX_BYTES = 2 << 30
# Some 200 bytes for each of 300,000 arrays.
MAX_HEADER = 64 << 20
START = b"{" + STORED + b'":{"sha256":"'
HEX = 64
# Behind the header's length, its start, and the digest.
PREFIX = 8 + len(START) + HEX
DTYPES = {
    "F64": "<f8", "F32": "<f4", "I64": "<i8", "I32": "<i4", "I16": "<i2", "I8": "|i1", "U64": "<u8", "U32": "<u4",
    "U16": "<u2", "U8": "|u1", "BOOL": "|b1",
}  # fmt: skip
CODES = {dtype: code for code, dtype in DTYPES.items()}
Kinds = Sequence[type]


def save(path: str | Path, schema: str, content: Mapping[str, Any]) -> None:
    """Write a tree to a file, whole or not at all."""
    parts = _parts(schema, content)
    with atomic_write(path) as stream:
        for part in parts:
            stream.write(part)


def load(path: str | Path, schema: str, kinds: Kinds = ()) -> dict[str, Any]:
    """Read the tree that `save` wrote to a file; the arrays are one's own.

    Raises `DataFormatError`: no such file, or it is damaged, of another schema, or holds a class not among `kinds`.
    """
    return loads(read_bytes(path, MAX_BYTES + 1), schema, kinds, path)


def dumps(schema: str, content: Mapping[str, Any]) -> bytes:
    """Give the bytes that `save` would write."""
    return b"".join(_parts(schema, content))


def loads(raw: bytes, schema: str, kinds: Kinds = (), path: str | Path = "state") -> dict[str, Any]:
    """Read the tree from the bytes of a file; `path` names them in errors."""
    stored = _opened(np.frombuffer(raw, np.uint8), schema, path)
    stored.check()
    return stored.content(kinds, own=True)


@dataclass(frozen=True, eq=False, slots=True)
class Stored:
    """A file that was opened: its header is checked, its arrays are not read yet."""

    path: str | Path
    sha256: str  # stands for the whole content
    raw: np.ndarray  # (n,) bytes of the arrays
    listing: dict[str, Any]  # the header's entries of the arrays
    about: dict[str, Any]  # the header's metadata

    def check(self) -> None:
        """Raise DataFormatError unless the arrays are as they were written; reads all of them."""
        if hashlib.sha256(self.raw.data).hexdigest() != self.about["data"]:
            raise DataFormatError(self.path, "its arrays are not what was written: damaged or changed; make it again")

    def content(self, kinds: Kinds = (), *, own: bool = False) -> dict[str, Any]:
        """Give the tree; its arrays are read-only views of the file, or copies of one's own."""
        with naming(self.path):
            arrays = {name: _view(self.raw, name, entry) for name, entry in self.listing.items()}
            if own:
                arrays = {name: array.copy() for name, array in arrays.items()}
            tree = _thawed(self.about["content"], arrays, kinds)
            if not isinstance(tree, dict):
                msg = f"expected an object, found a {type(tree).__name__}"
                raise TypeError(msg)
        return tree


def open_stored(path: str | Path, schema: str, *, is_mapped: bool = True) -> Stored:
    """Open a file that `save` wrote, mapped into memory: what this costs does not depend on the arrays' size.

    A mapped file shall not change while it is in use: who writes in place, not as `save` does, changes the arrays.
    """
    if not is_mapped:
        return _opened(np.frombuffer(read_bytes(path, MAX_BYTES + 1), np.uint8), schema, path)
    read_bytes(path, 1)  # refuses what is no file
    place = at_rest(path)
    return _opened(
        np.memmap(place, np.uint8, mode="r") if place.stat().st_size else np.zeros(0, np.uint8), schema, path
    )


@contextmanager
def naming(path: str | Path) -> Iterator[None]:
    """Turn what goes wrong while something is made of a file's content into one error that names the file."""
    try:
        yield
    except DataFormatError:
        raise
    except KeyError as error:
        raise DataFormatError(path, f"entry '{str(error.args[0])[:100]}' is missing") from None
    except ValidationError as error:
        place, words = first_fault(error)
        raise DataFormatError(path, f"config.{place}: {words}") from None
    except (ValueError, TypeError, OverflowError, AttributeError, IndexError, RecursionError) as error:
        words = " ".join(str(error).split())[:500] or type(error).__name__
        raise DataFormatError(path, words) from None


def expect(content: Mapping[str, Any], **kinds: type | tuple[type, ...] | list[type]) -> None:
    """Raise an error unless a tree has these entries, each of its class, or a list of such."""
    for name, kind in kinds.items():
        values = list(content[name]) if isinstance(kind, list) else [content[name]]
        one = kind[0] if isinstance(kind, list) else kind
        for value in values:
            if not isinstance(value, one):
                words = one.__name__ if isinstance(one, type) else " or ".join(each.__name__ for each in one)
                msg = f"entry '{name}': expected {words}, found {value!r:.60}"
                raise TypeError(" ".join(msg.split()))


def _parts(schema: str, content: Mapping[str, Any]) -> list[Any]:
    """Header, and the arrays in the order in which they are written."""
    found: dict[int, tuple[str, np.ndarray, Any]] = {}
    words = json.dumps(_frozen(content, "", found), allow_nan=False, separators=(",", ":"))
    # The widest first, so that all lie at multiples of their own width.
    arrays = sorted(((name, array) for name, array, _ in found.values()), key=lambda each: -each[1].itemsize)
    digest, at = hashlib.sha256(), 0
    listing: dict[str, Any] = {}
    for name, array in arrays:
        digest.update(array.data if array.size else b"")
        offsets = [at, at := at + array.nbytes]
        listing[name] = {"dtype": CODES[array.dtype.str], "shape": list(array.shape), "data_offsets": offsets}
    about = {"data": digest.hexdigest(), "schema": schema, "version": __version__, "content": words}
    rest = b'",' + json.dumps(about, separators=(",", ":"))[1:].encode()
    rest += (json.dumps(listing, separators=(",", ":")).replace("{", ",", 1) if listing else "}").encode()
    rest += b" " * (-(PREFIX + len(rest)) % 8)
    n_bytes = PREFIX + len(rest) + at
    if n_bytes > MAX_BYTES or PREFIX + len(rest) > MAX_HEADER:
        msg = f"expected at most {MAX_BYTES} bytes, of which {MAX_HEADER} of words, got {n_bytes} with {len(rest)}"
        raise ValueError(msg)
    head = START + hashlib.sha256(rest).hexdigest().encode() + rest
    return [len(head).to_bytes(8, "little") + head, *(array.data for _, array in arrays if array.size)]


def _opened(raw: np.ndarray, schema: str, path: str | Path) -> Stored:
    """Check the header of a file."""
    if len(raw) > MAX_BYTES:
        raise DataFormatError(path, f"is larger than any saved file ({MAX_BYTES} bytes)")
    start = raw[:PREFIX].tobytes()
    if start[8:-HEX] != START:
        found = f"{start[:16]!r}" if start else "nothing"
        raise DataFormatError(path, f"is not a file that magmatch saved: it begins with {found}")
    end = 8 + int.from_bytes(start[:8], "little")
    if not PREFIX <= end <= min(len(raw), MAX_HEADER):
        raise DataFormatError(path, f"is cut off or damaged: {len(raw)} bytes, of which {end} should be the header")
    rest, sha256 = raw[PREFIX:end].tobytes(), start[-HEX:].decode("latin-1")
    if hashlib.sha256(rest).hexdigest() != sha256:
        raise DataFormatError(path, "its header is not what was written: damaged or changed; make it again")
    with naming(path):
        header = json.loads(START + start[-HEX:] + rest, object_pairs_hook=unique_keys)
        about = header.pop("__metadata__")
        for name in ("data", "schema", "version", "content"):
            if not isinstance(about[name], str):
                msg = f"entry '{name}' of the header: expected words, found {about[name]!r:.60}"
                raise TypeError(msg)
        if (found := about["schema"]) != schema:
            is_version = found.rpartition("/")[0] == schema.rpartition("/")[0]
            advice = "; it is of another version of magmatch: update, or make it again" if is_version else ""
            raise DataFormatError(path, f"expected schema '{schema}', found {found[:60]!r}{advice}")
        _check_offsets(header, len(raw) - end)
    return Stored(path, sha256, raw[end:], header, about)


def _check_offsets(listing: Mapping[str, Any], n_bytes: int) -> None:
    """Refuse arrays that overlap, leave gaps, or need more or fewer bytes than they have."""
    at = 0
    for name, entry in listing.items():
        shape, offsets = entry["shape"], entry["data_offsets"]
        is_whole = all(type(n) is int and 0 <= n <= MAX_BYTES for n in [*shape, *offsets])
        if not is_whole or entry["dtype"] not in DTYPES or entry.keys() != {"dtype", "shape", "data_offsets"}:
            msg = f"entry '{name[:60]}': expected dtype, shape and offsets of an array, found {entry!r:.120}"
            raise ValueError(msg)
        size = np.dtype(DTYPES[entry["dtype"]]).itemsize * math.prod(shape)
        if offsets != [at, at + size]:
            msg = f"entry '{name[:60]}': expected {size} bytes from {at} on, found offsets {offsets}"
            raise ValueError(msg)
        at += size
    if at != n_bytes:
        msg = f"is cut off or too long: expected {at} bytes of arrays, found {n_bytes}"
        raise ValueError(msg)


def _view(raw: np.ndarray, name: str, entry: Mapping[str, Any]) -> np.ndarray:
    first, end = entry["data_offsets"]
    try:
        return np.asarray(raw[first:end]).view(DTYPES[entry["dtype"]]).reshape(entry["shape"])
    except ValueError as error:
        msg = f"entry '{name[:60]}': {error}"
        raise ValueError(msg) from None


def _frozen(value: Any, name: str, found: dict[int, tuple[str, np.ndarray, Any]]) -> Any:
    """Give a value as JSON: what JSON lacks is an object with one key, which begins with ``$``."""
    match value:
        case np.generic():
            return _frozen(value.item(), name, found)
        case Mapping():
            if any(not isinstance(key, str) or key.startswith("$") for key in value):
                msg = f"'{name}': expected words as keys that do not begin with '$', got {list(value)[:5]}"
                raise TypeError(msg)
            return {key: _frozen(each, f"{name}.{key}".lstrip("."), found) for key, each in value.items()}
        case float() if not math.isfinite(value):
            return {"$number": repr(value)}
    if type(value) is list:
        return [_frozen(each, f"{name}.{k}", found) for k, each in enumerate(value)]
    if value is None or type(value) in {bool, int, float, str}:
        return value
    return _frozen_object(value, name, found)


def _frozen_object(value: Any, name: str, found: dict[int, tuple[str, np.ndarray, Any]]) -> Any:
    match value:
        case np.ndarray():
            return _frozen_array(value, name, found)
        case RigidTransform():
            return {"$transform": _frozen(value.as_matrix(), name, found)}
        case Rotation():
            return {"$rotation": _frozen(value.as_quat(), name, found)}
    if type(value) is tuple:
        return {"$tuple": _frozen(list(value), name, found)}
    names = getattr(value, "_fields", saved_fields(value) if is_dataclass(value) else None)
    if names is None:
        msg = f"'{name}' is a {type(value).__name__}: expected numbers, words, arrays or dataclasses of them"
        raise TypeError(msg)
    return {f"${type(value).__name__}": _frozen({each: getattr(value, each) for each in names}, name, found)}


def saved_fields(value: Any) -> list[str]:
    """Names of the fields that make a dataclass, but for those that say that they are not saved."""
    return [f.name for f in fields(value) if f.init and f.metadata.get("is_saved", True)]


def _frozen_array(value: np.ndarray, name: str, found: dict[int, tuple[str, np.ndarray, Any]]) -> Any:
    """Put an array among those that are found, under a name of its own; one that is there already is named only."""
    if id(value) not in found:
        array = np.asarray(value, value.dtype.newbyteorder("<"), order="C")
        if array.dtype.names:
            array = np.frombuffer(array.tobytes(), np.uint8)
        if array.dtype.str not in CODES:
            msg = f"'{name}' is an array of {value.dtype}: expected numbers"
            raise TypeError(msg)
        taken = {each for each, *_ in found.values()}
        while (name or "array") in taken | {"__metadata__"}:
            name += "'"
        # Held, so that no other array takes its identity.
        found[id(value)] = (name or "array", array, value)
    name = found[id(value)][0]
    if value.dtype.names:
        return {"$rows": [name, value.dtype.newbyteorder("<").descr, list(value.shape)]}
    return {"$array": name}


def _thawed(words: str, arrays: dict[str, np.ndarray], kinds: Kinds) -> Any:
    """Undo `_frozen`."""
    makers: dict[str, Callable[[Any], Any]] = {
        "$number": float, "$array": arrays.__getitem__, "$transform": transform_from_matrix,
        "$rotation": _rotation, "$tuple": tuple,
        "$rows": lambda about: _rows(arrays, *about),
    }  # fmt: skip
    makers |= {f"${kind.__name__}": partial(_made, kind) for kind in kinds}

    def thaw(value: dict[str, Any]) -> Any:
        kind = next((key for key in value if key.startswith("$")), None)
        if kind is None:
            return value
        if len(value) > 1 or kind not in makers:
            msg = f"holds a {kind[1:60]}, which is not known here"
            raise TypeError(msg)
        return makers[kind](value[kind])

    return json.loads(words, object_hook=thaw)


def _made(kind: Callable[..., Any], values: dict[str, Any]) -> Any:
    return kind(**values)


def _rotation(quaternions: np.ndarray) -> Rotation:
    if not np.allclose(np.linalg.norm(quaternions, axis=-1), 1, rtol=0, atol=ORTHONORMAL_TOLERANCE):
        msg = "expected unit quaternions"
        raise ValueError(msg)
    # To normalise once more would change their last bits.
    return Rotation(quaternions, normalize=False)


def _rows(arrays: dict[str, np.ndarray], name: str, descr: list[Any], shape: list[int]) -> np.ndarray:
    """Give rows of several numbers each, of which the bytes are stored; whoever shares them gets the same array."""
    dtype = np.dtype([(field, of, *map(tuple, rest)) for field, of, *rest in descr])
    if dtype.hasobject:
        msg = f"entry '{name}': expected rows of numbers, found {dtype}"
        raise TypeError(msg)
    if arrays[name].dtype != dtype:
        arrays[name] = arrays[name].view(dtype).reshape(shape)
    return arrays[name]
