# SPDX-License-Identifier: BSD-3-Clause
"""MATLAB files: named arrays of numbers as the columns of a survey, read by SciPy (version 7.3 by h5py)."""

import logging
import struct
import warnings
import zlib
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import scipy.io

from magmatch.data.formats.format import SurveyFormat
from magmatch.data.survey_columns import (
    COLUMNS,
    FIELD_COLUMNS,
    GLOBAL_COLUMNS,
    choose_columns,
    constant_of,
    position_columns,
)
from magmatch.data.tables.table import Table, table_of_columns
from magmatch.data.tables.text import damage_told, plain_file, read_bytes
from magmatch.data.tables.times import seconds_of_column
from magmatch.data.units import UNITS_PER_SECOND
from magmatch.errors import DataFormatError, import_extra

logger = logging.getLogger(__name__)

# Arrays named in a message, and structures within structures.
MOST_LISTED, DEEPEST = 24, 8
ADVICE = "Say which arrays are the columns: --columns t=time,bx=mag:1,by=mag:2,bz=mag:3 (columns count from 1)"
# Types of parts, and classes of variables: MathWorks, "MAT-File Format", tables 1-1 and 1-3.
MATRIX, COMPRESSED = 14, 15
NUMBERS = frozenset({1, 2, 3, 4, 5, 6, 7, 9, 12, 13, 16, 17, 18})
FLAGS = (6, 8)  # type and bytes of the first part
SPARSE, ARRAYS, IS_COMPLEX = 5, range(6, 16), 0x800
HEADER, HEAD = 128, 4096  # bytes: of the file; of a variable, enough to tell its name


def read_mat(path: str | Path, layout: SurveyFormat) -> Table:
    """Read the columns of a survey from the arrays of a MATLAB file; rows count from 1 as lines in messages.

    An array is named as it is, ``data.mag`` within a structure, ``data.3.mag`` within the third of several; ``mag:2``
    is the second column of one with several.
    """
    stated = layout.stated_columns()
    own = (*COLUMNS, *(name for names in GLOBAL_COLUMNS.values() for name in names))
    is_v5 = read_bytes(path, 19) == b"MATLAB 5.0 MAT-file"
    with plain_file(path) as place, _opened(place, is_v5=is_v5) as content:
        arrays = _found(place, content, {text.partition(":")[0] for text in (*stated.values(), *own)})
        # Of the survey's own names only vectors are columns; what is stated may be a column of an array.
        vectors = [name for name in own if name in arrays and arrays[name].size == max(arrays[name].shape, default=1)]
        there = [text for text in stated.values() if text.partition(":")[0] in arrays]
        missing = [text for text in stated.values() if text not in there and constant_of(text) is None]
        names = list(dict.fromkeys([*there, *vectors]))
        if layout.rate is None and "t" not in (*stated, *vectors) and "t" in map(str.lower, content):
            logger.warning("%s: has no column t: its 't' holds no column of real numbers and is left out", path)
        if missing or not set(names) - {"t"}:
            expected = ", ".join(missing) or "x, y, z, bx, by, bz"
            found = ", ".join(_leaves(content))
            if not found:
                raise DataFormatError(
                    place, f"expected arrays {expected}; the file holds none: was it closed after writing?"
                )
            raise DataFormatError(place, f"expected arrays {expected}; found {found}. {ADVICE}")
        chosen = choose_columns(place, names, stated, has_poses=layout.trajectory is None)
        ticks = {name: UNITS_PER_SECOND[layout.time_unit] for name, ours in chosen.ours.items() if ours == "t"}
        columns = {
            name: seconds_of_column(_column(place, name, arrays[name.partition(":")[0]]), ticks.get(name, 1.0))
            for name in chosen.ours
        }
        table = replace(chosen.of(table_of_columns(path, columns, recover=layout.recover)), advice=ADVICE)
        # For the message about what is missing.
        is_whole = table.has(*position_columns(table), *FIELD_COLUMNS)
        return table if is_whole else replace(table, names=_leaves(content))


def _column(path: Path, name: str, array: np.ndarray) -> np.ndarray:
    """One column of an array."""
    what, mark, number = name.partition(":")
    if array.dtype.kind not in "iuf" or array.ndim > 2 or array.size == 0:
        message = f"expected an array of numbers, found {array.dtype.name[:20]} of {_shape(array)}"
        raise DataFormatError(path, message, column=what)
    if not mark and array.size == max(array.shape, default=1):
        return array.reshape(-1)
    rows = array if array.ndim == 2 else array.reshape(1, -1)
    rows = rows if rows.shape[0] <= rows.shape[1] else rows.T
    if not number.isdecimal() or not 1 <= int(number) <= len(rows):
        example = f"{what}:1" + (f" to {what}:{len(rows)}" if len(rows) > 1 else "")
        raise DataFormatError(path, f"expected one column of {_shape(array)}, {example}; found '{name}'", column=what)
    return np.asarray(rows[int(number) - 1])


def _shape(array: np.ndarray) -> str:
    return " x ".join(map(str, array.shape)) or "one number"


@contextmanager
def _opened(path: Path, *, is_v5: bool) -> Iterator[Mapping[str, Any]]:
    """Content of a file: mappings of names to arrays, other mappings, and what is neither."""
    with damage_told(path, "MATLAB file"):
        if is_v5:
            yield _Variables(path)
        else:
            h5py = import_extra("h5py", "reading MATLAB 7.3 and HDF5 files", "matlab")
            with h5py.File(path, "r") as file:
                yield file


class _Variables(Mapping[str, Any]):
    """Variables of a file of version 5, each read when it is asked for: others may be large, or damaged."""

    def __init__(self, path: Path) -> None:
        names = [name for name, *_ in scipy.io.whosmat(path, appendmat=False)]
        self._path, self._names = path, dict.fromkeys(name for name in names if not name.startswith("__"))
        self._read: dict[str, Any] = {}

    def __iter__(self) -> Iterator[str]:
        return iter(self._names)

    def __len__(self) -> int:
        return len(self._names)

    def __getitem__(self, name: str) -> Any:
        if name not in self._read:
            _require_parts(self._path, name)
            with warnings.catch_warnings():
                warnings.simplefilter("ignore")  # such as of a name that is there twice
                found = scipy.io.loadmat(self._path, variable_names=[name], appendmat=False)
            self._read[name] = _plain(found.get(name))
        return self._read[name]


def _plain(value: Any) -> Any:
    """Arrays of real numbers, and structures as mappings (of several, by number, counted from 1); else None."""
    if type(value) is not np.ndarray or not (value.dtype.names or value.dtype.kind in "iuf"):
        return None
    if value.dtype.names is None:
        return value
    rows = [{name: _plain(row[name]) for name in value.dtype.names} for row in value.ravel(order="F")]
    return rows[0] if len(rows) == 1 else {str(k): row for k, row in enumerate(rows, start=1)}


def _found(path: Path, content: Mapping[str, Any], wanted: set[str]) -> dict[str, np.ndarray]:
    """Arrays by the names by which they are wanted (dots lead into structures); HDF5 in MATLAB's order of axes."""
    found = {}
    for name in wanted:
        place: Any = content
        for part in name.split("."):
            key = next((key for key in place if key.lower() == part), None) if isinstance(place, Mapping) else None
            if key is None:
                place = None
            else:
                place = place[key] if isinstance(place, dict | _Variables) else _linked(path, place, key)
        if isinstance(place, np.ndarray):
            found[name] = place
    return found


def _linked(path: Path, group: Any, key: str) -> Any:
    """A group or array of HDF5; links out of the file are not followed."""
    import h5py

    if not isinstance(group.get(key, getlink=True), h5py.HardLink):
        return None
    found = group[key]
    if not isinstance(found, h5py.Dataset):
        return found
    if found.external or found.is_virtual:
        raise DataFormatError(path, "the array lies in other files; expected one file", column=key)
    if found.shape is None:
        raise DataFormatError(path, "expected an array of numbers, found an empty one", column=key)
    return np.asarray(found).T


def _leaves(content: Mapping[str, Any]) -> tuple[str, ...]:
    """Names with dots, and sizes, of all that is no structure, as `read_mat` names them; for a message."""
    names: list[str] = []
    waiting: list[tuple[str, Any]] = [("", content)]
    while waiting and len(names) < MOST_LISTED:
        name, place = waiting.pop(0)
        if isinstance(place, Mapping) and name.count(".") < DEEPEST:
            prefix = f"{name}." if name else ""
            waiting[:0] = [(prefix + key, place.get(key)) for key in place if not key.startswith("#")]
        else:
            shape = getattr(place, "shape", None)
            names.append(name[:60] + (f" ({' x '.join(map(str, shape))})" if shape else ""))
    return (*names, "...") if waiting else tuple(names)


def _require_parts(path: Path, name: str) -> None:
    """Require that the variables of a name consist of the parts that their class has, of known types.

    SciPy reads numbers of no known type outside its memory.
    """
    data = memoryview(path.read_bytes())
    order = "<" if bytes(data[126:128]) == b"IM" else ">"
    for kind, part in _parts(data[HEADER:], order):
        is_packed = kind == COMPRESSED
        head = zlib.decompressobj().decompress(part, HEAD) if is_packed else part[:HEAD]
        named = _parts(memoryview(head)[8 if is_packed else 0 :], order)[2:3]  # behind flags and sizes
        if named and bytes(named[0][1]) == name.encode("latin1"):
            for one in _parts(memoryview(zlib.decompress(part)), order) if is_packed else [(kind, part)]:
                _require(*one, order)


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


def _require(kind: int, content: memoryview, order: str) -> None:
    if kind not in NUMBERS | {MATRIX}:
        msg = f"a part of unknown type {kind}"
        raise ValueError(msg)
    parts = _parts(content, order) if kind == MATRIX else []
    if not parts:
        return  # numbers, or an empty variable
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
