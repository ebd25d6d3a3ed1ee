# SPDX-License-Identifier: BSD-3-Clause
"""Registration and localisation need an index of a base map, made when first needed and kept beside the map.

What is kept is a cache: it is used only for the content of the map and the program that it was made by. Nothing is
lost by deleting it, and where it cannot be written it is made each time.
"""

import hashlib
import json
import logging
from dataclasses import dataclass, field, replace
from functools import cache, partial
from pathlib import Path
from typing import Any

import numpy as np

from magmatch.brief import brief
from magmatch.errors import DataFormatError
from magmatch.estimation.limits import N_DRAWS
from magmatch.estimation.path_noise import PathNoise, learn_path_noise
from magmatch.field.map import FieldMap
from magmatch.field.saved_map import MapFile
from magmatch.registration.prepared.drift import Drift
from magmatch.registration.prepared.prepared_map import PreparedMap, known_samples, prepare
from magmatch.registration.prepared.raster import Raster, rasterize
from magmatch.registration.search.kdtree import NeighbourTree
from magmatch.registration.search.pair_search import PairTable, tabulate_pairs
from magmatch.runner import program
from magmatch.store import Stored, naming, open_stored, save
from magmatch.threads import one_blas_thread

log = logging.getLogger(__name__)

SCHEMA = "magmatch.index/6"
SUFFIX = ".index"
KINDS = (NeighbourTree, PairTable, PathNoise)
# What is stored of `PreparedMap`.
PREPARED = ("points", "point_field", "point_gradient", "gradient_sd", "invariants", "invariant_sd")


@dataclass(frozen=True, eq=False, slots=True)
class WalkIndex:
    """A base map made ready for walks."""

    base: PreparedMap
    # What residuals of another walk look like, for registrations and for localisation
    noise: PathNoise
    live_noise: PathNoise
    table: PairTable

    @property
    def length(self) -> float:
        """The base's correlation length, m."""
        return self.base.correlation_length


@dataclass(frozen=True, eq=False, slots=True)
class MapIndex:
    """A base map made ready for any number of targets.

    Attributes
    ----------
    base : PreparedMap
        If the map has a file, all that is made is kept beside it, as soon as it is made.
    """

    base: PreparedMap
    _walks: list[WalkIndex] = field(default_factory=list, repr=False)
    # As a tree of `magmatch.store`: what follows from the base alone, and further rasters by their spacing
    _parts: dict[str, Any] = field(default_factory=dict, init=False, repr=False)
    _rasters: dict[str, Any] = field(default_factory=dict, init=False, repr=False)

    __repr__ = brief

    @property
    def walks(self) -> WalkIndex:
        """The part that walks need in addition, computed on first use; this takes seconds unless it was kept."""
        if not self._walks:
            self._walks.append(index_walks(self.base, _base_rng()))
            self.keep()
        return self._walks[0]

    def raster(self, spacing: float) -> Raster:
        """Give a raster of the map of another spacing (m), computed on first use."""
        if repr(spacing) not in self._rasters:
            self._rasters[repr(spacing)] = _packed(rasterize(self.field_map, spacing, self.base.draws()))
            self.keep()
        return Raster.knowing(**self._rasters[repr(spacing)])

    @property
    def is_whole(self) -> bool:
        """Whether what walks need was computed."""
        return bool(self._walks)

    @property
    def length(self) -> float:
        """The base's correlation length, m."""
        return self.base.correlation_length

    @property
    def volume(self) -> float:
        """Volume of the region that the map knows, m^3."""
        return self.base.raster.volume

    @property
    def field_map(self) -> FieldMap:
        """The map itself."""
        return self.base.field_map

    def content(self) -> dict[str, Any]:
        """Give what was prepared so far as a tree of `magmatch.store`."""
        if not self._parts:
            draws = self.base.draws()
            self._parts.update({
                "correlation_length": self.base.correlation_length,
                "noise_sd": self.base.noise_sd,
                "volume": self.volume,
                "prepared": {name: getattr(self.base, name) for name in PREPARED},
                "raster": _packed(self.base.raster),
                "n_draws": len(draws),
                "draws": np.stack(draws) if all(isinstance(weights, np.ndarray) for weights in draws) else None,
            })  # fmt: skip
        walks = None
        if self.is_whole:
            table = self.walks.table
            table = replace(table, first=table.first.astype(np.int32), second=table.second.astype(np.int32))
            walks = {"noise": self.walks.noise, "live_noise": self.walks.live_noise, "table": table}
        file = self.field_map.file
        return self._parts | {"key": index_key(file) if file else "", "walks": walks, "rasters": self._rasters}

    def keep(self) -> None:
        """Write what was prepared so far beside the map, where that is allowed and the map is still the same."""
        try:
            if (file := self.field_map.file) is not None and MapFile.of(file.path) == file:
                save(index_path(file.path), SCHEMA, self.content())
        except (OSError, ValueError) as error:
            log.debug("what was prepared of a map is not kept: %s", error)


@dataclass(frozen=True, eq=False, slots=True)
class IndexFile:
    """An index in its file, opened but hardly read."""

    content: dict[str, Any]  # of `MapIndex.content`
    stored: Stored | None = None  # where it comes from; None if it could not be kept

    @property
    def key(self) -> str:
        """The key of the map and the program it was made from."""
        return str(self.content["key"])

    @property
    def is_whole(self) -> bool:
        """Whether it holds what walks need, too."""
        return self.content["walks"] is not None

    @property
    def volume(self) -> float:
        """Volume of the region that the map knows, m^3."""
        return float(self.content["volume"])

    @property
    def table(self) -> PairTable:
        """Pairs of points, read on demand; of a complete index."""
        table: PairTable = self.content["walks"]["table"]
        return table

    def load(self, field_map: FieldMap) -> MapIndex:
        """Read all of it, given the map that it was made of; raises DataFormatError if it is damaged."""
        if self.stored is not None:
            self.stored.check()
        with naming(self.stored.path if self.stored else "index"):
            return self._loaded(field_map)

    def _loaded(self, field_map: FieldMap) -> MapIndex:
        parts, survey = dict(self.content), known_samples(field_map)
        base = PreparedMap(
            field_map=field_map,
            T_map_model=field_map.T_map_model,
            posterior=field_map.posterior,
            samples=survey.positions,
            sample_field=survey.field,
            raster=Raster.knowing(**parts["raster"]),
            correlation_length=parts["correlation_length"],
            noise_sd=parts["noise_sd"],
            drift=Drift.of(survey, field_map.posterior),
            draws=cache(partial(_draws, parts["draws"], field_map, parts["n_draws"])),
            **{name: np.array(parts["prepared"][name]) for name in PREPARED},
        )
        index = MapIndex(base)
        walks = parts.pop("walks")
        if walks is not None:
            index._walks.append(WalkIndex(base, walks["noise"], walks["live_noise"], self.table))
        index._rasters.update(parts.pop("rasters"))
        index._parts.update(parts)
        return index


def prepare_index(base: FieldMap | MapIndex) -> MapIndex:
    """Give the index of a base map, as it was kept, or made now.

    It is independent of the seed, so that what was kept gives the same answer.
    """
    if isinstance(base, MapIndex):
        return base
    kept = open_index(base.file) if base.file else None
    if kept is not None:
        try:
            return kept.load(base)
        except DataFormatError as error:
            log.debug("%s", error)
    # With more threads the order of sums changes, and what was kept would give other bits than the map itself.
    with one_blas_thread():
        prepared = prepare(base, N_DRAWS, _base_rng())
    index = MapIndex(prepared)
    index.keep()
    return index


def index_walks(base: PreparedMap, rng: np.random.Generator) -> WalkIndex:
    """Learn the residuals' covariance and list the base's pairs of points, once for all walks."""
    noise, live_noise = learn_path_noise(base.field_map, base.correlation_length, rng)
    return WalkIndex(base, noise, live_noise, tabulate_pairs(base, noise.total_sd))


def _base_rng() -> np.random.Generator:
    return np.random.default_rng(0)


def _draws(kept: np.ndarray | None, field_map: FieldMap, n_draws: int) -> list[Any]:
    """Posterior samples as stored; those of a tiled map are drawn again when they are needed."""
    return list(field_map.posterior.draw_weights(n_draws, _base_rng()) if kept is None else np.array(kept))


def _packed(raster: Raster) -> dict[str, Any]:
    """Arguments of `Raster.knowing`."""
    known = np.flatnonzero(raster.sd >= 0)
    return {
        "origin": raster.origin, "spacing": float(raster.spacing), "shape": raster.sd.shape,
        "rows": known.astype(np.int32), "field": raster.field.reshape(-1, 3)[known], "sd": raster.sd.ravel()[known],
    }  # fmt: skip


def index_path(map_path: str | Path) -> Path:
    """Name the file for what was prepared of a saved map: it lies beside the map, with ``.index`` added."""
    path = Path(map_path)
    return path.with_name(path.name + SUFFIX)


def index_key(file: MapFile) -> str:
    """Give the key of a valid index: SHA-256 of the map's content and the program."""
    return hashlib.sha256(json.dumps([file.sha256, program()]).encode()).hexdigest()


def open_index(file: MapFile) -> IndexFile | None:
    """Open what was prepared of a saved map.

    None if there is none, or it was made from other content or by another version.
    """
    try:
        stored = open_stored(index_path(file.path), SCHEMA)
        index = IndexFile(stored.content(KINDS), stored)
    except DataFormatError as error:
        log.debug("nothing is kept: %s", error)
        return None
    return index if index.key == index_key(file) else None
