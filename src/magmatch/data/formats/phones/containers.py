# SPDX-License-Identifier: BSD-3-Clause
"""Tables of a phone's export in a folder or a zip archive: nothing is unpacked to the disk."""

import posixpath
import zipfile
from collections.abc import Callable, Collection, Iterable, Iterator
from contextlib import contextmanager, suppress
from functools import partial
from pathlib import Path

from magmatch.data.formats.phones.tables import MEMBERS, says_its_sensor, stem_of
from magmatch.data.tables.pipes import at_rest
from magmatch.data.tables.text import damage_told, is_folder, read_bytes
from magmatch.errors import DataFormatError, in_short

# Tables with other names are looked into: so many bytes of so many.
MAX_HEADER, MAX_LOOKED_INTO = 4096, 64


@contextmanager
def opened_tables(path: str | Path) -> Iterator[dict[Path, Callable[[], bytes]]]:
    """Tables of phones in a folder, an archive, or the file itself: where each stands, and how to read it."""
    place = Path(path)
    if is_folder(path):
        names = sorted(entry.name for entry in place.iterdir() if not entry.is_fifo())  # which might be waited for
        found = phone_tables(names, lambda name: read_bytes(place / name, MAX_HEADER))
        yield {place / name: partial(read_bytes, place / name) for name in found}
    elif not zipfile.is_zipfile(at_rest(path)):
        yield {place: partial(read_bytes, place)}
    else:
        with zipfile.ZipFile(at_rest(path)) as archive:
            refuse_strays(place, archive.namelist())
            found = phone_tables_of(place, archive)
            yield {place / name: partial(_read_member, place, archive, name) for name in found}


def member(path: Path, name: str) -> bytes | None:
    """Content of one further file of a folder or archive, in whichever folder of it; None where there is none."""
    if is_folder(path):
        return read_bytes(path / name) if (path / name).is_file() else None
    if not zipfile.is_zipfile(at_rest(path)):
        return None
    with zipfile.ZipFile(at_rest(path)) as archive:
        found = [n for n in archive.namelist() if f"/{n.lower()}".endswith(f"/{name.lower()}") and not is_hidden(n)]
        return _read_member(path, archive, found[0]) if found else None


def phone_tables_of(path: Path, archive: zipfile.ZipFile) -> list[str]:
    """Names of the tables of a phone's sensors in an archive; none that is packed once more, which no app does.

    Apps write a log into one folder: tables in several are several logs, and refused.
    """
    plain = [name for name in archive.namelist() if not name.lower().endswith(".gz")]
    found = phone_tables(plain, lambda name: _read_member(path, archive, name, MAX_HEADER))
    folders = sorted({posixpath.dirname(posixpath.normpath(name.replace("\\", "/"))) for name in found})
    if len(folders) > 1:
        listed = ", ".join(folder or "(top)" for folder in in_short(folders))
        message = f"holds a phone's tables in {len(folders)} folders ({listed}): several logs? Unpack it"
        raise DataFormatError(path, f"{message} and give one folder, with all tables of one log in it")
    return found


def phone_tables(names: Iterable[str], head_of: Callable[[str], bytes]) -> list[str]:
    """Names of the tables of a phone's sensors, the preferred first: by name, else by header."""
    order = list(MEMBERS)
    tables = [name for name in names if name.lower().endswith((".csv", ".csv.gz")) and not is_hidden(name)]
    known = sorted((name for name in tables if stem_of(name) in MEMBERS), key=lambda n: (order.index(stem_of(n)), n))
    others = [name for name in tables if stem_of(name) not in MEMBERS and "meta" not in Path(name).parts]
    for name in others[:MAX_LOOKED_INTO]:
        with suppress(DataFormatError):  # what cannot be looked into
            head = head_of(name).decode("utf-8-sig", "replace")
            known += [name] if says_its_sensor(head.partition("\n")[0].strip(), stem_of(name)) else []
    return known


def is_hidden(name: str) -> bool:
    """Whether this is what a system keeps beside a file (``__MACOSX``, ``._name``)."""
    parts = Path(name.replace("\\", "/")).parts
    return "__MACOSX" in parts or (bool(parts) and parts[-1].startswith("."))


def refuse_strays(path: Path, names: Collection[str]) -> None:
    """Refuse an archive with a name that would leave it."""
    for name in names:
        parts = name.replace("\\", "/").split("/")
        if ".." in parts or not parts[0] or parts[0].endswith(":"):
            raise DataFormatError(path, f"holds a name that leaves the archive: {name[:60]!r}")


def _read_member(path: Path, archive: zipfile.ZipFile, name: str, limit: int = -1) -> bytes:
    if archive.getinfo(name).flag_bits & 1:
        raise DataFormatError(path, f"{name} is encrypted; unpack it first")
    with damage_told(path, "zip archive"), archive.open(name) as stream:
        return stream.read(limit)
