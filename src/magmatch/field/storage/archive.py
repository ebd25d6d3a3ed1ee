# SPDX-License-Identifier: BSD-3-Clause
"""Float64 arrays and attributes in one file: Zarr v3 in a zip, every entry checked by its SHA-256.

Nothing is compressed, so a file never asks for more memory than it is long, and the same content gives the same
bytes. What is read is checked before it is decoded: a map may come from anywhere.
"""

import hashlib
import json
import struct
import zipfile
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from io import BytesIO
from pathlib import Path
from typing import Any

import numpy as np
from pydantic import ValidationError

from magmatch._version import __version__
from magmatch.atomic import atomic_write
from magmatch.data.tables.text import read_bytes
from magmatch.errors import DataFormatError, first_fault
from magmatch.field.storage.archive_checks import (
    MAX_BYTES,
    MAX_ENTRIES,
    check_array,
    check_entry,
    check_outside,
    one_line,
    parse,
)

# A group of its own, so that any Zarr reader can list the file without stumbling over it.
MANIFEST = "manifest/zarr.json"
ROWS_PER_CHUNK = 65_536
# What zip adds to an entry: two headers and its name twice, rounded up.
ENTRY_OVERHEAD = 300
# The oldest time a zip can state: the bytes shall not depend on when they were written.
EPOCH = (1980, 1, 1, 0, 0, 0)
# All that zipfile raises over a damaged archive.
ZIP_ERRORS = (zipfile.BadZipFile, RuntimeError, EOFError, ValueError, KeyError, OverflowError, struct.error)


def write_archive(
    path: str | Path, schema: str, attributes: Mapping[str, Any], arrays: Mapping[str, np.ndarray]
) -> None:
    """Write arrays and attributes as one file, whole or not at all."""
    entries = _zarr_entries(attributes, arrays)
    listing = {
        name: {"bytes": len(content), "sha256": hashlib.sha256(content).hexdigest()}
        for name, content in sorted(entries.items())
    }
    about = {"schema": schema, "version": __version__, "entries": listing}
    manifest = {"zarr_format": 3, "node_type": "group", "attributes": about}
    entries[MANIFEST] = json.dumps(manifest, indent=1).encode()
    n_bytes = sum(len(content) + ENTRY_OVERHEAD for content in entries.values())
    if n_bytes >= MAX_BYTES or len(entries) > MAX_ENTRIES:
        msg = f"expected less than {MAX_BYTES} bytes in {MAX_ENTRIES} entries, got {n_bytes} in {len(entries)}"
        raise ValueError(msg)
    with atomic_write(path) as stream, zipfile.ZipFile(stream, "w", zipfile.ZIP_STORED) as archive:
        for name in sorted(entries):
            info = zipfile.ZipInfo(name, EPOCH)
            info.create_system, info.external_attr = 3, 0o644 << 16
            archive.writestr(info, entries[name])


def _zarr_entries(attributes: Mapping[str, Any], arrays: Mapping[str, np.ndarray]) -> dict[str, bytes]:
    """Keys and values of the Zarr hierarchy."""
    import zarr
    from zarr.codecs import BytesCodec, Crc32cCodec
    from zarr.storage import MemoryStore

    store: dict[str, Any] = {}
    group = zarr.create_group(store=MemoryStore(store), zarr_format=3, attributes=dict(attributes))
    for name, array in arrays.items():
        stored = group.create_array(
            name,
            shape=array.shape,
            dtype="float64",
            chunks=(min(max(len(array), 1), ROWS_PER_CHUNK), *array.shape[1:]),
            filters=None,
            serializer=BytesCodec(endian="little"),
            compressors=[Crc32cCodec()],
            fill_value=0.0,
            # All zeros are data too, and get their checksum.
            config={"write_empty_chunks": True},
        )
        stored[...] = np.asarray(array, dtype=np.float64)
    return {name: value.to_bytes() for name, value in store.items()}


def read_archive(path: str | Path, schema: str) -> tuple[dict[str, Any], dict[str, np.ndarray]]:
    """Attributes and float64 arrays that `write_archive` wrote, after checking all of them."""
    content = read_bytes(path, MAX_BYTES + 1)
    check_outside(path, content)
    try:
        with zipfile.ZipFile(BytesIO(content)) as archive:
            entries = _verified_entries(path, archive, schema)
    except ZIP_ERRORS as error:
        if isinstance(error, DataFormatError):
            raise
        raise DataFormatError(path, f"is a damaged zip archive: {one_line(error)}") from None
    arrays = {}
    for name in sorted({n.split("/")[0] for n in entries if "/" in n}):
        check_array(path, name, entries)
        arrays[name] = _decode(path, name, entries)
    attributes = parse(path, "zarr.json", entries["zarr.json"]).get("attributes")
    if not isinstance(attributes, dict):
        raise DataFormatError(path, "entry 'zarr.json' has no attributes")
    return attributes, arrays


def fingerprint_archive(path: str | Path) -> str:
    """SHA-256 that stands for all of an archive's content, read from its manifest alone.

    The manifest lists the hash of every entry. Damage of an entry is found by `read_archive`.
    """
    read_bytes(path, 1)  # refuses what is no file: a pipe would be waited for
    try:
        with zipfile.ZipFile(path) as archive:
            info = archive.getinfo(MANIFEST)
            check_entry(path, info)
            return hashlib.sha256(archive.read(info)).hexdigest()
    except OSError as error:
        raise DataFormatError(path, f"cannot be read: {error.strerror or error}") from None
    except ZIP_ERRORS as error:
        if isinstance(error, DataFormatError):
            raise
        raise DataFormatError(path, f"is not a saved map: {one_line(error)}") from None


def _verified_entries(path: str | Path, archive: zipfile.ZipFile, schema: str) -> dict[str, bytes]:
    """Content of every entry but the manifest, each as the manifest says."""
    infos = archive.infolist()
    for info in infos:
        check_entry(path, info)
    names = [info.filename for info in infos]
    if len(set(names)) < len(names):
        raise DataFormatError(path, "holds two entries of one name")
    if MANIFEST not in names:
        raise DataFormatError(path, f"is not a saved map: entry '{MANIFEST}' is missing")
    listing = _listing(path, _content(path, archive, MANIFEST), schema)
    for name in sorted(listing.keys() - set(names)):
        raise DataFormatError(path, f"entry '{name}' is missing")
    for name in sorted(set(names) - listing.keys() - {MANIFEST}):
        raise DataFormatError(path, f"entry '{name}' is not in the manifest")
    entries = {}
    for name, claim in listing.items():
        entries[name] = _content(path, archive, name)
        if claim != {"bytes": len(entries[name]), "sha256": hashlib.sha256(entries[name]).hexdigest()}:
            raise DataFormatError(path, f"entry '{name}' is not what the manifest says (damaged or changed)")
    if "zarr.json" not in entries:
        raise DataFormatError(path, "entry 'zarr.json' is missing")
    return entries


def _content(path: str | Path, archive: zipfile.ZipFile, name: str) -> bytes:
    try:
        return archive.read(name)
    except (*ZIP_ERRORS, OSError) as error:
        raise DataFormatError(path, f"entry '{name}' is damaged: {one_line(error)}") from None


def _listing(path: str | Path, content: bytes, schema: str) -> dict[str, Any]:
    """Entries of the manifest, once its schema is the one expected."""
    about = parse(path, MANIFEST, content).get("attributes")
    found = about.get("schema") if isinstance(about, dict) else None
    if not isinstance(about, dict) or found != schema:
        family = schema.rpartition("/")[0] + "/"
        is_newer = isinstance(found, str) and found.startswith(family)
        advice = "; it was written by another version of magmatch: update, or build the map again" if is_newer else ""
        raise DataFormatError(path, f"entry '{MANIFEST}': expected schema '{schema}', found {found!r}{advice}")
    listing = about.get("entries")
    if not isinstance(listing, dict) or MANIFEST in listing:
        raise DataFormatError(path, f"entry '{MANIFEST}' lists no entries")
    return listing


def _decode(path: str | Path, name: str, entries: Mapping[str, bytes]) -> np.ndarray:
    """One array, through Zarr, from entries that were checked."""
    import zarr
    from zarr.core.buffer import default_buffer_prototype
    from zarr.storage import MemoryStore

    make = default_buffer_prototype().buffer.from_bytes
    held = {n.removeprefix(f"{name}/"): make(v) for n, v in entries.items() if n.startswith(f"{name}/")}
    try:
        array = zarr.open_array(MemoryStore(held), mode="r", zarr_format=3)
        return np.array(array[...], dtype=np.float64)
    except (ValueError, KeyError, TypeError) as error:
        raise DataFormatError(path, f"entry '{name}/zarr.json': {one_line(error)}") from None


@contextmanager
def naming_entries(path: str | Path) -> Iterator[None]:
    """Turn what goes wrong while a record is made of an archive's content into one error that names the entry."""
    try:
        yield
    except KeyError as error:
        raise DataFormatError(path, f"entry '{error.args[0]}' is missing") from None
    except ValidationError as error:
        place, words = first_fault(error)
        raise DataFormatError(path, f"entry 'zarr.json', config.{place}: {words}") from None
    except (ValueError, TypeError, OverflowError) as error:
        raise DataFormatError(path, " ".join(str(error).split())) from None
