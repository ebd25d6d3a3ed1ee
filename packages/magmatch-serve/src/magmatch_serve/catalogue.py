# SPDX-License-Identifier: BSD-3-Clause
"""The maps that are served are looked at now and then; one that is added or replaced is served once it is whole."""

import hashlib
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from magmatch.data.tables.text import is_folder
from magmatch.errors import DataFormatError
from magmatch.registration.index.atlas import maps_in
from magmatch_serve.refusals import without_paths


@dataclass(frozen=True, slots=True)
class Listing:
    """Maps as they lie on the disk: name, time of change (ns) and bytes of each."""

    maps: tuple[tuple[str, int, int], ...]

    @property
    def names(self) -> list[str]:
        """Names of the maps."""
        return [name for name, *_ in self.maps]

    @property
    def version(self) -> str:
        """A text that tells listings apart."""
        return hashlib.sha256(repr(self.maps).encode()).hexdigest()[:12]


def look_at(place: Path) -> Listing:
    """List the maps of a folder, or the one."""
    paths = list(maps_in(place)) if is_folder(place) else [place]
    stats = [(path.name, path.stat()) for path in paths]
    return Listing(tuple((name, stat.st_mtime_ns, stat.st_size) for name, stat in stats))


@dataclass(eq=False, slots=True)
class Catalogue:
    """The listing that is served, and one that may replace it."""

    place: Path
    served: Listing
    fault: str | None = None  # why a newer one is not served
    _seen: Listing | None = None
    _refused: set[str] = field(default_factory=set)

    def newer(self) -> Listing | None:
        """A listing that differs from the one that is served, once two looks agree: nobody is writing it."""
        try:
            now = look_at(self.place)
        except DataFormatError as error:
            self.fault = str(error)
            return None
        except OSError:
            if not self.place.exists():
                self.fault = f"{self.place}: is gone"
            return None  # or a file that goes while it is looked at
        if now == self.served:
            self.fault = None
        elif not now.maps:
            self.fault = f"{self.place}: holds no map any more"
        before, self._seen = self._seen, now
        is_new = now != self.served and now.maps and now.version not in self._refused
        return now if is_new and now == before else None

    def settle(self, listing: Listing, faults: list[str]) -> None:
        """Serve a listing, or keep the old one and say why."""
        if faults:
            self.fault = faults[0]
            self._refused = {listing.version}
        else:
            self.served, self.fault = listing, None

    def document(self) -> dict[str, Any]:
        """Describe it as JSON."""
        maps = [
            {"name": n, "bytes": size, "version": Listing(((n, t, size),)).version} for n, t, size in self.served.maps
        ]
        return {
            "version": self.served.version, "maps": maps,
            "fault": None if self.fault is None else without_paths(self.fault, {self.place: "maps"}),
        }  # fmt: skip
