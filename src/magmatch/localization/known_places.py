# SPDX-License-Identifier: BSD-3-Clause
"""A map, or a folder of maps, each prepared once for any number of bodies."""

from collections.abc import Callable, Collection, Sequence
from concurrent.futures import Executor, Future
from dataclasses import replace
from functools import cached_property
from pathlib import Path
from typing import Any, TypeVar

import numpy as np

from magmatch.arguments import expect_kind
from magmatch.data.fingerprint import hash_survey
from magmatch.data.formats.sniff import sniff
from magmatch.data.sensor_axes import is_constant
from magmatch.data.tables.text import is_folder
from magmatch.errors import DataFormatError
from magmatch.estimation.limits import MAX_LOADED
from magmatch.field.map import FieldMap
from magmatch.localization.known_map import KnownMap
from magmatch.registration.index.atlas import Atlas, AtlasEntry, open_atlas
from magmatch.registration.index.map_index import SUFFIX, MapIndex
from magmatch.registration.maps import survey_of

Place = FieldMap | MapIndex | Atlas
T = TypeVar("T")
ADVICE = (
    "FieldMap.load(path) reads a saved map, build_map(survey) makes one, open_atlas(folder) opens a folder of maps"
)


class NotReadyError(Exception):
    """A map is being made ready: ask again."""


class KnownPlaces:
    """Maps that many localizers share.

    The loader prepares maps and counts votes in the background; without one, the body that needs them waits.
    """

    def __init__(self, place: Place, loader: Executor | None = None) -> None:
        expect_kind(place, "place", (FieldMap, MapIndex, Atlas), ADVICE)
        self.loader = loader
        # The folder of maps, or the only map.
        self.atlas: Atlas | None
        self.alone: FieldMap | MapIndex | None
        self.atlas, self.alone = (place, None) if isinstance(place, Atlas) else (None, place)
        self._making: dict[AtlasEntry | None, Future[KnownMap]] = {}
        self._ready: dict[AtlasEntry | None, KnownMap] = {}
        self._fingerprint: str | None = None

    @cached_property
    def is_constant(self) -> bool:
        """Whether the only map's field is the same everywhere: it has no field length either."""
        return self.alone is not None and is_constant(survey_of(self.alone).field)

    @cached_property
    def length(self) -> float:
        """Field length, m: in a folder, the median one; of a constant field, any."""
        if self.atlas is not None:
            return float(np.median([entry.table.length for entry in self.atlas.entries]))
        return 4.0 if self.is_constant else self.of(None).length

    @property
    def entries(self) -> Sequence[AtlasEntry | None]:
        """The entries of an atlas; None for a single map."""
        return (None,) if self.atlas is None else self.atlas.entries

    def fingerprint(self, entry: AtlasEntry | None) -> str:
        """Tell a version of a map from others: by its index's key, or by its samples and its field length."""
        if entry is not None:
            return entry.index.key
        if self._fingerprint is None:
            self._fingerprint = f"{hash_survey(self.of(entry).index.field_map.survey)} {self.of(entry).length!r}"
        return self._fingerprint

    def soon(self, entry: AtlasEntry | None) -> KnownMap | None:
        """Give a map as `of` does, or None while the loader makes it ready; what the loader raised is raised here."""
        if self.loader is None or entry in self._ready:
            return self.of(entry)
        if entry not in self._making:
            self._making[entry] = self.aside(self._make, entry)
        # Whoever asked for a map may have stopped waiting for it.
        for other in [key for key, future in self._making.items() if future.done() and not future.exception()]:
            self._ready[other] = self._making.pop(other).result()
        if entry in self._making and self._making[entry].done():
            # It failed, and would again.
            self._making[entry].result()
        return self.of(entry) if entry in self._ready else None

    def aside(self, function: Callable[..., T], *arguments: Any) -> Future[T]:
        """Let the loader do something; without one it is done at once."""
        if self.loader is not None:
            return self.loader.submit(function, *arguments)
        done: Future[T] = Future()
        done.set_result(function(*arguments))
        return done

    def of(self, entry: AtlasEntry | None) -> KnownMap:
        """Give the map of an atlas's entry, or the only one, ready; those that were needed last stay so."""
        known = self._ready.pop(entry, None)
        if known is None:
            known = self._make(entry)
        self._ready[entry] = known
        while len(self._ready) > MAX_LOADED:
            self._ready.pop(next(iter(self._ready)))
        return known

    def _make(self, entry: AtlasEntry | None) -> KnownMap:
        if self.alone is not None:
            return KnownMap.of(self.alone)
        assert entry is not None
        assert self.atlas is not None
        # Wherever it is found, it was looked for in all maps.
        return replace(KnownMap.of(self.atlas.load(entry)), name=entry.name, volume=self.atlas.volume)


def open_place(path: Path, names: Collection[str] | None = None) -> Place:
    """Open a map, or a folder of maps, all or those of some names."""
    if is_folder(path):
        return open_atlas(path, names=names)
    path = path.with_suffix("") if path.suffix == SUFFIX else path  # whose index may be given
    if (found := sniff(path)) != "map":
        advice = "make a map with 'magmatch map SURVEY --out MAP'"
        raise DataFormatError(path, f"expected a saved map, found a {found} file; {advice}")
    return FieldMap.load(path)
