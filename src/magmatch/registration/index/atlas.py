# SPDX-License-Identifier: BSD-3-Clause
"""A target may lie in one map, or in one of many: `Atlas`, a folder of maps, each in its own frame."""

import logging
from collections.abc import Collection, Iterator
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from magmatch.arguments import expect_path
from magmatch.brief import brief
from magmatch.data.formats.sniff import may_be_map
from magmatch.data.survey import Survey
from magmatch.data.tables.text import is_folder
from magmatch.errors import ConfigurationError, DataFormatError
from magmatch.estimation.limits import MAX_LOADED
from magmatch.field.map import FieldMap
from magmatch.field.saved_map import MapFile
from magmatch.progress import Progress, followed, tell
from magmatch.registration.config import RegistrationConfig, settings_of
from magmatch.registration.index.map_index import IndexFile, MapIndex, index_key, open_index, prepare_index
from magmatch.registration.prepared.prepared_map import PreparedMap
from magmatch.registration.search.pair_search import PairTable
from magmatch.registration.search.retrieval import count_agreement, count_votes, shortlist
from magmatch.threads import single_threaded

log = logging.getLogger(__name__)


@dataclass(frozen=True, eq=False, slots=True)
class AtlasEntry:
    """One map of an atlas."""

    path: Path  # the saved map
    index: IndexFile
    table: PairTable  # its pairs of points, mapped into memory

    @property
    def name(self) -> str:
        """Name of the file."""
        return self.path.name


@dataclass(frozen=True, eq=False, slots=True)
class Atlas:
    """Many maps, ready to be searched; those that were used stay in memory.

    Attributes
    ----------
    entries : tuple of AtlasEntry
        In the order of their names.
    config : RegistrationConfig
        What registrations in it are asked.
    """

    folder: Path
    entries: tuple[AtlasEntry, ...]
    config: RegistrationConfig
    _loaded: dict[Path, MapIndex] = field(default_factory=dict)

    __repr__ = brief

    @property
    def volume(self) -> float:
        """Volume of all regions together, m^3."""
        return sum(entry.index.volume for entry in self.entries)

    @property
    def length(self) -> float:
        """Median of the maps' correlation lengths, m."""
        return self.length_of(list(self.entries))

    def length_of(self, likely: list[AtlasEntry]) -> float:
        """Median of some maps' correlation lengths, m."""
        return float(np.median([entry.table.length for entry in likely]))

    def name_of(self, entry: AtlasEntry) -> str:
        """Name of a map's file."""
        return entry.name

    def likely_for_walk(self, target: Survey, seed: int) -> list[AtlasEntry]:
        """Maps in which most of a walk's pairs of points agree on one pose."""
        tell(f"asking {len(self.entries)} maps")
        votes = count_votes([entry.table for entry in self.entries], target, seed)
        return [self.entries[k] for k in shortlist(votes)]

    def likely_for_map(self, target: PreparedMap, seed: int) -> list[AtlasEntry]:
        """Maps in which the best of a few poses of a target agrees best."""
        tell(f"asking {len(self.entries)} maps")
        votes = count_agreement((self.load(entry).base for entry in self.entries), target, seed)
        return [self.entries[k] for k in shortlist(votes)]

    def load(self, entry: AtlasEntry) -> MapIndex:
        """Give a map with its index, from memory if it is there.

        Raises
        ------
        DataFormatError
            The map is damaged, or was replaced.
        """
        index = self._loaded.pop(entry.path, None)
        if index is None:
            field_map = FieldMap.load(entry.path)
            if field_map.file is None or index_key(field_map.file) != entry.index.key:
                raise DataFormatError(entry.path, "was replaced after its folder was opened; open the folder again")
            try:
                index = entry.index.load(field_map)
            except DataFormatError as error:
                log.info("%s; indexing it again", error)
                index = prepare_index(field_map)
        self._loaded[entry.path] = index
        while len(self._loaded) > MAX_LOADED:
            self._loaded.pop(next(iter(self._loaded)))
        return index


@dataclass(frozen=True, eq=False, slots=True)
class OneBase:
    """A single map, which needs no votes."""

    index: MapIndex

    @property
    def length(self) -> float:
        """Its correlation length, m."""
        return self.index.length

    @property
    def volume(self) -> float:
        """Volume of the region that it knows, m^3."""
        return self.index.volume

    def likely_for_walk(self, target: Survey, seed: int) -> list[MapIndex]:  # noqa: ARG002
        """The map itself."""
        return [self.index]

    def likely_for_map(self, target: PreparedMap, seed: int) -> list[MapIndex]:  # noqa: ARG002
        """The map itself."""
        return [self.index]

    def length_of(self, likely: list[MapIndex]) -> float:
        """Its correlation length, m."""
        return likely[0].length

    def load(self, one: MapIndex) -> MapIndex:
        """The map itself."""
        return one

    def name_of(self, one: MapIndex) -> None:
        """None."""


# What a target may lie in; their steps are alike
Bases = Atlas | OneBase


@single_threaded
def open_atlas(
    folder: str | Path,
    config: RegistrationConfig | None = None,
    *,
    names: Collection[str] | None = None,
    progress: Progress | None = None,
) -> Atlas:
    """Open a folder of saved maps. Maps whose index is missing or stale are indexed, which takes seconds each.

    Parameters
    ----------
    folder : path
        All saved maps in it are used, whatever their names; other files are ignored.
    config : RegistrationConfig, optional
        Preset ``default`` unless given.
    names : collection of str, optional
        Of the files to use; nothing else is looked at.
    progress : callable, optional
        Called with the current step and the fraction done; see `magmatch.progress`.

    Raises
    ------
    DataFormatError
        No such folder, or no map in it, or one that is damaged.
    ConfigurationError
        Settings that decide by fitness alone (preset ``paper``), which cannot compare maps.
    """
    expect_path(folder, "folder")
    config, folder = settings_of(config), Path(folder)
    if config.search == "keypoints":
        msg = "a folder of maps as the base: these settings decide by fitness, which does not compare maps"
        raise ConfigurationError(msg)
    paths = list(maps_in(folder, names))
    if not paths:
        message = "holds no saved maps; make some with 'magmatch map SURVEY --out FOLDER/NAME.map'"
        raise DataFormatError(folder, message)
    opened = {path: open_index(MapFile.of(path)) for path in paths}
    stale = [path for path, index in opened.items() if index is None or not index.is_whole]
    with followed(progress):
        for number, path in enumerate(stale):
            tell(f"indexing {path.name} ({number + 1} of {len(stale)})", number / len(stale))
            opened[path] = _prepared(path)
    entries = [AtlasEntry(path, index, index.table) for path, index in opened.items() if index is not None]
    return Atlas(folder, tuple(entries), config)


def is_atlas(path: str | Path) -> bool:
    """Whether a path is a folder that holds saved maps."""
    return is_folder(path) and next(maps_in(Path(path)), None) is not None


def maps_in(folder: Path, names: Collection[str] | None = None) -> Iterator[Path]:
    """Saved maps of a folder, all or those of some names, in the order of their names.

    Raises `DataFormatError` where there is no such folder.
    """
    if folder.is_file():
        raise DataFormatError(folder, "is a file, expected a folder of saved maps")
    try:
        paths = sorted(path for path in folder.iterdir() if path.is_file())
    except OSError as error:
        raise DataFormatError(folder, f"cannot be read: {error.strerror or error}") from None
    for path in paths:
        if path.name.startswith(".") or not (names is None or path.name in names):
            continue
        # What else is kept, such as indexes, says that it is no map.
        if may_be_map(path):
            yield path


def _prepared(path: Path) -> IndexFile:
    """Prepare a map, and open what was kept of that; where nothing can be kept, it stays in memory."""
    index = prepare_index(FieldMap.load(path))
    tell("listing pairs of points for walks")
    index.walks  # noqa: B018  # asked for, it is prepared
    kept = open_index(MapFile.of(path))
    return kept if kept is not None and kept.is_whole else IndexFile(index.content())
