# SPDX-License-Identifier: BSD-3-Clause
"""Exports of phone loggers: Sensor Logger and phyphox, as a table, a folder or a zip archive."""

import logging
import re
import zipfile
from pathlib import Path
from typing import Any

from magmatch.data.formats.sniff import BROKEN_ZIP, PHONE_MEMBERS, is_phone_member
from magmatch.data.tables.table import Table, read_table
from magmatch.data.tables.text import is_folder, read_bytes, text_lines
from magmatch.errors import DataFormatError

logger = logging.getLogger(__name__)

# What both apps write, whatever the phone: microtesla, in the phone's own axes.
PHONE_DEFAULTS: dict[str, Any] = {"field_unit": "uT", "field_frame": "sensor"}
# Bounds, stated in docs/formats.md: hours of samples are some 10 MB, and text packs 3 to 20 times.
MAX_MEMBER = 256 << 20  # bytes
MAX_RATIO = 200

# Column names of the apps, lower case -> ours. Sensor Logger: whole nanoseconds since 1970.
_SENSOR_LOGGER = {"time": "t", "x": "bx", "y": "by", "z": "bz"}
_PHYPHOX = re.compile(r"magnetic field ([xyz]) \([µμu]t\)")
_PHYPHOX_TIME = "time (s)"


def read_phone(path: str | Path) -> Table:
    """Read the magnetometer of a phone log."""
    place, raw = _samples_of(path)
    if place.name.lower() == PHONE_MEMBERS[-1]:
        logger.warning("%s: read without the phone's own calibration; expect an offset ('magmatch prepare')", place)
    lines = text_lines(place, raw)
    header = next((line for line in lines if line.strip()), "")
    mark = next((mark for mark in (",", ";", "\t") if mark in header), ",")
    names = {}
    for cell in header.lower().split(mark):
        name = cell.strip().strip("'\"")
        ours = _our_name(name, is_sensor_logger="seconds_elapsed" in header.lower())
        if ours:
            names[name] = ours
    table = read_table(place, list(names), raw=raw).renamed(names)
    table.require(["t", "bx", "by", "bz"])
    if "time" in names:
        table = Table(
            table.path, table.names, table.columns | {"t": table.columns["t"] / 1e9}, table.line_numbers, ()
        )
    return table


def _our_name(name: str, *, is_sensor_logger: bool) -> str | None:
    if is_sensor_logger:
        return _SENSOR_LOGGER.get(name)
    axis = _PHYPHOX.fullmatch(name)
    return "b" + axis.group(1) if axis else {_PHYPHOX_TIME: "t"}.get(name)


def _samples_of(path: str | Path) -> tuple[Path, bytes]:
    """The table of the magnetometer, and where it stands."""
    if is_folder(path):
        found = [entry for entry in Path(path).iterdir() if is_phone_member(entry.name)]
        chosen = min(found, key=lambda entry: PHONE_MEMBERS.index(entry.name.lower()))
        return chosen, _bounded(chosen, read_bytes(chosen, MAX_MEMBER + 1))
    if not zipfile.is_zipfile(path):
        return Path(path), _bounded(Path(path), read_bytes(path, MAX_MEMBER + 1))
    try:
        with zipfile.ZipFile(path) as archive:
            return _member_of(Path(path), archive)
    except BROKEN_ZIP as error:
        if isinstance(error, DataFormatError):
            raise
        raise DataFormatError(path, f"is a damaged zip archive ({error})") from None
    except OSError as error:  # decompressors report damage this way
        raise DataFormatError(path, f"is a damaged zip archive ({error})") from None


def _member_of(path: Path, archive: zipfile.ZipFile) -> tuple[Path, bytes]:
    """Read one member; nothing is ever unpacked to the disk."""
    stray = [name for name in archive.namelist() if name.startswith(("/", "\\")) or ".." in Path(name).parts]
    if stray:
        raise DataFormatError(path, f"holds a name that leaves the archive: {stray[0][:60]!r}")
    members = [info for info in archive.infolist() if is_phone_member(info.filename)]
    info = min(members, key=lambda m: (PHONE_MEMBERS.index(Path(m.filename).name.lower()), m.filename))
    if info.flag_bits & 1:
        raise DataFormatError(path, f"{info.filename} is encrypted; unpack it first")
    if info.file_size > min(MAX_MEMBER, MAX_RATIO * info.compress_size + (1 << 20)):
        message = (
            f"{info.filename} declares {info.file_size} bytes out of {info.compress_size}: refused as a zip bomb"
        )
        raise DataFormatError(path, message)
    with archive.open(info) as stream:
        return path / info.filename, stream.read(info.file_size + 1)


def _bounded(place: Path, raw: bytes) -> bytes:
    if len(raw) > MAX_MEMBER:
        raise DataFormatError(place, f"is larger than {MAX_MEMBER} bytes, more than a phone logs")
    return raw
