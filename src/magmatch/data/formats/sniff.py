# SPDX-License-Identifier: BSD-3-Clause
"""Tell what a file is by its content, before its name."""

import itertools
import json
import re
import zipfile
from pathlib import Path
from typing import Literal

from magmatch.data.formats.phones.containers import opened_tables, phone_tables_of, refuse_strays
from magmatch.data.formats.phones.tables import is_phone_header
from magmatch.data.formats.phones.text_logs import text_log_of
from magmatch.data.survey_columns import FIELD_COLUMNS
from magmatch.data.tables.header_names import header_of, is_of_rostopic
from magmatch.data.tables.motive import is_of_motive
from magmatch.data.tables.number_marks import is_number
from magmatch.data.tables.pipes import at_rest
from magmatch.data.tables.text import damage_told, is_folder, is_gzip, read_bytes, text_lines
from magmatch.data.tables.text_rows import MAX_TITLES, is_row, mark_of, split_header, stated_delimiter
from magmatch.data.tables.tum import TUM_COLUMNS
from magmatch.data.tables.yaml_text import mapping_in
from magmatch.data.units import MEBI
from magmatch.errors import DataFormatError

FileKind = Literal["csv", "map", "registration", "tum", "euroc", "log", "parquet", "mat", "phone", "rostopic"]

_NO_WORKBOOKS = "export the sheet as CSV (phyphox: choose CSV, not Excel, under 'Export Data')"
_NO_PICKLES = "pickles are never read, since they can run code; export it as CSV"
# How files begin that people hand over by mistake, what they are, and what to do about it.
_FOREIGN: tuple[tuple[bytes | tuple[bytes, ...], str, str], ...] = (
    (b"\x1f\x8b", "twice compressed gzip", "decompress it first (gunzip)"),
    (b"BZh", "bzip2", "decompress it first (bunzip2)"),
    (b"\xfd7zXZ\0", "xz", "decompress it first (unxz)"),
    (b"\x28\xb5\x2f\xfd", "Zstandard", "decompress it first (unzstd)"),
    (b"7z\xbc\xaf\x27\x1c", "7-Zip", "unpack it first"),
    (b"ULog\x01\x12\x35", "PX4 ULog", "export the field and the poses as text"),
    (b"\x93NUMPY", "NumPy", "export it as CSV"),
    (b"\x89PNG", "PNG picture", "expected samples, not a picture"),
    (b"\xff\xd8\xff", "JPEG picture", "expected samples, not a picture"),
    (b"%PDF", "PDF document", "expected samples, not a document"),
    (b"\xd0\xcf\x11\xe0", "old Excel workbook", _NO_WORKBOOKS),
    ((b"\x80\x04\x95", b"\x80\x05\x95"), "Python pickle", _NO_PICKLES),
    (b"version https://git-lfs", "Git LFS pointer", "fetch the content it points to (git lfs pull)"),
    ((b"<!DOCTYPE", b"<!doctype", b"<html"), "web page", "download the raw file instead"),
    (b"<table", "web page", "export it as CSV"),
    (
        (b"VERTEX_SE", b"EDGE_SE"),
        "g2o pose graph",
        "its poses have no times: give a trajectory of rows t x y z qx qy qz qw",
    ),
    (b"<?xml", "XML document", "export it as CSV"),
    (b"log,component,t,", "slam covariances", "the surveys that slam or merge wrote lie beside it"),
)
# A ROS 2 bag may also be a folder of such files.
_SIGNATURES: dict[bytes, FileKind] = {
    b"SQLite format 3\0": "log",
    b"#ROSBAG V": "log",
    b"\x89MCAP0\r\n": "log",
    b"PAR1": "parquet",
    b"MATLAB 5.0 MAT-file": "mat",
    b"MATLAB 7.3 MAT-file": "mat",
    b"\x89HDF\r\n\x1a\n": "mat",
}
# How a saved file (`magmatch.store`) begins, behind eight bytes that may be any.
STORED = b'"__metadata__'
_STORED_HEAD = 400  # bytes: two digests and the schema
_REGISTRATION_SCHEMA = "magmatch.registration/"
_HEAD = MEBI  # bytes that decide; only the comments of a text file can be longer


def sniff(path: str | Path) -> FileKind:
    """Tell what a file is; one that cannot be read is refused with what it seems to be and what to do."""
    if is_folder(path):
        return _sniff_folder(path)
    head = read_bytes(path, _HEAD)
    if _is_stored(head):
        _refuse_gzip(path, "a saved map")
        if found := _other_schema(head):
            raise DataFormatError(path, f"holds '{found}', expected a survey (CSV) or a saved map")
        return "map"
    kind = next((kind for signature, kind in _SIGNATURES.items() if head.startswith(signature)), None)
    if kind is not None:
        return kind
    if head.startswith((b"PK\x03\x04", b"PK\x05\x06")):
        _refuse_gzip(path, "a zip archive")
        return _sniff_archive(path)
    for signature, what, advice in _FOREIGN:
        if head.startswith(signature):
            raise DataFormatError(path, f"is a {what} file, expected a survey (CSV) or a saved map; {advice}")
    if head.lstrip(b"\xef\xbb\xbf \t\r\n")[:1] in {b"{", b"["}:
        _refuse_gzip(path, "JSON")
        return _sniff_json(path)
    return "phone" if text_log_of(head) else _sniff_text(path, head)


def may_be_map(path: Path) -> bool:
    """Whether a file of a folder is a saved map, damaged or not; archives and workbooks beside maps are none."""
    with path.open("rb") as stream:
        head = stream.read(_STORED_HEAD)
    return _is_stored(head) and not _other_schema(head)


def _is_stored(head: bytes) -> bool:
    """Whether a file was saved by `magmatch.store`: told loosely, so that one damaged byte hides no map."""
    return STORED in head[:64] or head[4:9] == b"\0\0\0\0{"


def _other_schema(head: bytes) -> str:
    """Schema of a saved file that is no map; none where it cannot be read."""
    found = re.search(rb'"schema":"(magmatch\.[\w./]*)"', head[:_STORED_HEAD])
    return "" if found is None or found[1].startswith(b"magmatch.map/") else found[1].decode()


def _refuse_gzip(path: str | Path, content: str) -> None:
    """Only logs and tables are read through gzip."""
    if is_gzip(Path(path)):
        raise DataFormatError(path, f"is a gzip file of {content}; decompress it first (gunzip)")


def _sniff_text(path: str | Path, head: bytes) -> FileKind:
    """Text is told by its first row, or by a header that looks like a comment."""
    if len(head) == _HEAD and b"\n" in head and not head.startswith((b"\xff\xfe", b"\xfe\xff")):
        head = head[: head.rindex(b"\n")]  # the last line, and its last character, may be cut
    lines = [line.strip() for line in text_lines(path, head)]
    rows = [line for line in lines if is_row(line)][: MAX_TITLES + 1]
    mark = stated_delimiter(rows[0]) if rows else None
    if mark:
        rows.pop(0)
    first = rows[0] if rows else ""
    if any(map(is_phone_header, rows)):
        return "phone"
    cells = first.split()
    if is_of_motive(first) or (len(cells) == len(TUM_COLUMNS) and all(map(is_number, cells))):
        return "tum"
    if kind := _kind_by_names(path, first, mark):
        return kind
    above = itertools.takewhile(lambda line: not line or line.startswith("#"), lines)
    is_euroc = any(line.lstrip("# \t").lower().startswith("timestamp") and "," in line for line in above)
    return "euroc" if is_euroc and all(map(is_number, first.rstrip(", \t").split(","))) else "csv"


def _kind_by_names(path: str | Path, first: str, mark: str | None) -> FileKind | None:
    """A trajectory, if a header names its columns and none that may be a field; of a ROS message, either kind."""
    if ";" in first and "," in first:  # read as a survey, which says what is wrong
        return None
    header = header_of(split_header(first, mark_of(path, first, 1, mark)))
    others = {name for word, name in zip(header.words, header.names, strict=True) if word} - set(TUM_COLUMNS)
    is_message = is_of_rostopic(header.words)
    if header.names_all(TUM_COLUMNS) and (is_message or others <= {"?"}):
        return "tum"
    return "rostopic" if is_message and header.names_all(("t", *FIELD_COLUMNS)) else None


def _sniff_folder(path: str | Path) -> FileKind:
    """A folder is a ROS 2 bag where it holds what recorders write."""
    try:
        names = [entry.name for entry in Path(path).iterdir()]
    except PermissionError:
        raise DataFormatError(path, "no permission to read it") from None
    if "metadata.yaml" in names or any(name.endswith((".db3", ".mcap", ".db3.zstd", ".mcap.zstd")) for name in names):
        return "log"
    with opened_tables(path) as tables:
        if tables:
            return "phone"
    raise DataFormatError(
        path, "is a folder, expected a file, a ROS 2 bag (metadata.yaml) or a phone log (Magnetometer.csv)"
    )


def _sniff_archive(path: str | Path) -> FileKind:
    """A zip archive is a phone's export, or nothing we read."""
    with damage_told(path, "zip archive"), zipfile.ZipFile(at_rest(path)) as archive:
        members = archive.namelist()
        has_tables = bool(phone_tables_of(Path(path), archive))
    if "[Content_Types].xml" in members or any(name.lower().endswith((".xls", ".xlsx")) for name in members):
        raise DataFormatError(path, f"is an Excel workbook or Office document, or holds one; {_NO_WORKBOOKS}")
    if has_tables:
        refuse_strays(Path(path), members)
        return "phone"
    if all(name.lower().endswith((".csv", ".txt", "/")) for name in members):
        raise DataFormatError(path, f"is a zip archive of {len(members)} text files or none; unpack it first")
    if all(name.endswith(".npy") for name in members):
        raise DataFormatError(
            path, "is a NumPy .npz archive, expected a survey (CSV) or a saved map; export it as CSV"
        )
    raise DataFormatError(path, f"is a zip archive of {len(members)} files, none of them a phone's; unpack it first")


def _sniff_json(path: str | Path) -> FileKind:
    """JSON is a registration result, or nothing we read."""
    try:
        content = json.loads(read_bytes(path).decode("utf-8-sig"))
    except (ValueError, RecursionError) as error:
        raise DataFormatError(path, f"begins like JSON but is not: {error}") from None
    if isinstance(content, list) and any("sensor" in mapping_in(row) for row in content[:1]):
        raise DataFormatError(path, "is a phone's log in JSON, as Sensor Logger writes it; export it as CSV")
    schema = mapping_in(content).get("schema")
    if str(schema).startswith(_REGISTRATION_SCHEMA):
        return "registration"
    if str(schema).startswith("magmatch.slam/"):
        raise DataFormatError(
            path, "is a result of slam or merge; its map is map.map beside it, its surveys are there too"
        )
    found = f"with schema {schema!r}" if schema else "without a schema"
    message = f"is JSON {found}, expected schema '{_REGISTRATION_SCHEMA}1', a survey (CSV) or a saved map"
    raise DataFormatError(path, message)
