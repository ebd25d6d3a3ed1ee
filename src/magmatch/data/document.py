# SPDX-License-Identifier: BSD-3-Clause
"""JSON documents that notice when they were changed: written whole with a checksum, read strictly."""

import hashlib
import json
import math
import re
from collections.abc import Mapping
from dataclasses import fields, is_dataclass
from enum import Enum
from pathlib import Path
from typing import Any, ClassVar, Self, TypeVar

import numpy as np
from pydantic import TypeAdapter, ValidationError
from scipy.spatial.transform import RigidTransform

from magmatch.arguments import expect_path
from magmatch.atomic import write_whole
from magmatch.data.tables.text import read_bytes
from magmatch.data.tables.yaml_text import mapping_in
from magmatch.errors import DataFormatError, first_fault
from magmatch.geometry import transform_from_matrix

T = TypeVar("T")

_DIGEST = re.compile("[0-9a-fA-F]{16,}")
# Keys whose value may look like one.
_WORDS = {"version", "base", "reason", "name"}
_ADAPTERS: dict[type, TypeAdapter[Any]] = {}


def write_document(path: str | Path, document: Mapping[str, Any]) -> None:
    """Write a document with its checksum, one key a line, whole or not at all.

    The checksum stands second: damage that takes the end of the file, and closes it again, cannot take it along.
    """
    lines = [f'  "{key}": {json.dumps(value, allow_nan=False)}' for key, value in document.items()]
    lines.insert(1, f'  "checksum": "{checksum(document)}"')
    write_whole(path, ("{\n" + ",\n".join(lines) + "\n}\n").encode())


def checksum(document: Mapping[str, Any]) -> str:
    """SHA-256 of what a document says, whatever the order and layout of its keys and ``1`` or ``1.0``."""
    rest = {key: _canonical(value) for key, value in document.items() if key != "checksum"}
    text = json.dumps(rest, allow_nan=False, sort_keys=True, separators=(",", ":"))
    return hashlib.sha256(text.encode()).hexdigest()


def _canonical(value: Any) -> Any:
    match value:
        case dict():
            return {key: _canonical(v) for key, v in value.items()}
        case list():
            return [_canonical(v) for v in value]
        case float() if value.is_integer() and abs(value) < 2**53:
            return int(value)
    return value


def read_document(path: str | Path, schema: str, what: str, max_bytes: int) -> dict[str, Any]:
    """Read a document and check its schema and, where it has one, its checksum; `what` names its kind in errors."""
    content = read_bytes(path, max_bytes + 1)
    if len(content) > max_bytes:
        raise DataFormatError(path, f"is larger than any {what} ({max_bytes} bytes)")
    try:
        text = content.decode("utf-8-sig")
        loaded = json.loads(text, object_pairs_hook=unique_keys, parse_constant=_refuse, parse_float=_finite)
        document: dict[str, Any] = mapping_in(loaded)
        # Files from elsewhere need not have a checksum.
        is_changed = document.get("checksum") not in (None, checksum(document))
    except (ValueError, RecursionError) as error:
        raise DataFormatError(path, f"is not a {what} (JSON): {error}") from None
    found = document.get("schema")
    if found != schema:
        is_newer = str(found).startswith(schema.rpartition("/")[0] + "/")
        advice = "; it was written by another version of magmatch: update, or make it again" if is_newer else ""
        raise DataFormatError(path, f"key 'schema': expected '{schema}', found {found!r}{advice}")
    if is_changed:
        advice = "make it again, or delete the key 'checksum' if the change is meant"
        raise DataFormatError(path, f"key 'checksum': the file was changed after it was written; {advice}")
    told = {key: value for key, value in document.items() if isinstance(value, str) and key not in _WORDS}
    damaged = next((key for key, value in told.items() if _DIGEST.fullmatch(value)), None)
    if damaged is not None and "checksum" not in document:
        raise DataFormatError(path, f"key {damaged[:40]!r} seems to be a damaged 'checksum'; make the file again")
    return document


def adapter_of(kind: type[T]) -> TypeAdapter[T]:
    """Give the validator of a type, built when it is first needed."""
    if kind not in _ADAPTERS:
        _ADAPTERS[kind] = TypeAdapter(kind)
    return _ADAPTERS[kind]


class TypedDocument:
    """A dataclass that is a file: its fields, in their order, under a schema."""

    __slots__ = ()
    SCHEMA: ClassVar[str]
    # What errors call it, and how large it is at most.
    KIND: ClassVar[str]
    MAX_BYTES: ClassVar[int] = 256 * 1024**2

    @staticmethod
    def key(name: str) -> str:
        """Key of the file for a field."""
        return name

    def fault(self) -> tuple[str, str] | None:
        """Key of a value that contradicts others, and what was expected; None where nothing does."""
        return None

    def to_dict(self) -> dict[str, Any]:
        """The result in lists, numbers and words, with keys and order as in the file."""
        names = [f.name for f in fields(self)]  # type: ignore[arg-type]
        return {"schema": self.SCHEMA} | {self.key(n): plain(getattr(self, n), self.key(n)) for n in names}

    def save(self, path: str | Path) -> None:
        """Write the result as JSON (layout in ``docs/formats.md``), whole or not at all.

        `DataFormatError` where the folder does not exist.
        """
        write_document(path, self.to_dict())

    @classmethod
    def load(cls, path: str | Path) -> Self:
        """Read a result; saving it again gives the same bytes.

        Raises
        ------
        DataFormatError
            Not such a file, or one of its values cannot be; names the key.
        """
        expect_path(path)
        document = read_document(path, cls.SCHEMA, cls.KIND, cls.MAX_BYTES)
        try:
            found = adapter_of(cls).validate_python(document)
            fault = found.fault()
        except ValidationError as error:
            fault = first_fault(error)
        if fault is not None:
            raise DataFormatError(path, f"key '{fault[0]}': {fault[1]}")
        return found


def unique_keys(pairs: list[tuple[str, Any]]) -> dict[str, Any]:
    """Refuse an object with a repeated key: readers differ in which value they take."""
    made = dict(pairs)
    if len(made) < len(pairs):
        msg = f"one of the keys {[name[:20] for name in sorted(made)[:5]]} appears twice"
        raise ValueError(msg)
    return made


def _refuse(constant: str) -> float:
    msg = f"{constant} is not a JSON number"
    raise ValueError(msg)


def _finite(text: str) -> float:
    """Refuse a number too large for float64, which would be read as infinity."""
    value = float(text)
    return value if math.isfinite(value) else _refuse(text[:40])


def plain(value: Any, key: str) -> Any:
    """Turn arrays, transforms and dataclasses into lists and mappings, non-finite numbers into None, for JSON."""
    match value:
        case RigidTransform():
            # Reading it gives the same bits.
            value = transform_from_matrix(value.as_matrix()).as_matrix().tolist()
        case np.ndarray() | np.generic():
            value = value.tolist()
        case Enum():
            value = value.value
        case Path():
            value = str(value)
        case _ if is_dataclass(value):
            value = {f.name: getattr(value, f.name) for f in fields(value)}
    match value:
        case Mapping():
            return {str(k): plain(v, f"{key}.{k}") for k, v in value.items()}
        case list() | tuple():
            return [plain(v, key) for v in value]
        case float():
            return value if math.isfinite(value) else None
        case None | bool() | int() | str():
            return value
    msg = f"'{key}' holds a {type(value).__name__}, expected numbers, words, lists or mappings"
    raise TypeError(msg)
