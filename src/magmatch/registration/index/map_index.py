# SPDX-License-Identifier: BSD-3-Clause
"""What registration needs of one base map, computed once for any number of targets and stored next to the map.

An index is a cache: it records the map, the settings and the version that it was made from, and is stale if any of
them differs. Nothing is lost by deleting it.
"""

import hashlib
import json
import logging
from collections.abc import Callable
from dataclasses import asdict, dataclass, field
from functools import cache, partial
from pathlib import Path
from typing import Any

import numpy as np

from magmatch._version import __version__
from magmatch.brief import brief
from magmatch.errors import DataFormatError
from magmatch.field.map import FieldMap
from magmatch.field.storage.archive import fingerprint_archive
from magmatch.progress import Progress, followed, tell
from magmatch.registration.config import RegistrationConfig
from magmatch.registration.index.mapped_arrays import MappedArrays, open_mapped, write_mapped
from magmatch.registration.index.walk_index import WalkIndex, index_walks
from magmatch.registration.prepared.drift import Drift
from magmatch.registration.prepared.path_noise import PathNoise
from magmatch.registration.prepared.prepared_map import PreparedMap, known_samples, prepare
from magmatch.registration.prepared.raster import Raster
from magmatch.registration.search.kdtree import NeighbourTree
from magmatch.registration.search.pair_search import PairTable
from magmatch.threads import one_blas_thread

log = logging.getLogger(__name__)

SCHEMA = "magmatch.index/5"
SUFFIX = ".index"
# What is stored of `PreparedMap`, of `PairTable` and its tree, and the table's numbers.
PREPARED = ("points", "point_field", "point_gradient", "gradient_sd", "invariants", "invariant_sd")
TABLE, TREE = ("positions", "field", "first", "second"), ("points", "rows", "axes", "values")
TABLE_SCALARS = ("length", "sd_position", "sd_field", "field_norm", "gradient_rms")


@dataclass(frozen=True, eq=False, slots=True)
class MapIndex:
    """A base map made ready for any number of targets.

    Attributes
    ----------
    base : PreparedMap
    make_walks : callable
        Gives what walks need in addition; this takes seconds unless it is read from a file.
    """

    base: PreparedMap
    make_walks: Callable[[], WalkIndex]
    _walks: list[WalkIndex] = field(default_factory=list, init=False, repr=False)

    __repr__ = brief

    @property
    def walks(self) -> WalkIndex:
        """What walks need in addition, computed on first use."""
        if not self._walks:
            self._walks.append(self.make_walks())
        return self._walks[0]

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

    def save(self, path: str | Path, key: str) -> None:
        """Write what was prepared so far, with the key of `index_key`; an existing file is replaced."""
        base, raster = self.base, self.base.raster
        known = np.flatnonzero(raster.sd >= 0)
        arrays = {f"prepared.{name}": getattr(base, name) for name in PREPARED} | {
            "raster.rows": known.astype(np.int32),
            "raster.field": raster.field.reshape(-1, 3)[known],
            "raster.sd": raster.sd.ravel()[known],
        }
        draws = base.draws()
        if all(isinstance(weights, np.ndarray) for weights in draws):
            arrays["draws"] = np.stack(draws)
        attributes: dict[str, Any] = {
            "key": key,
            "correlation_length": base.correlation_length,
            "noise_sd": base.noise_sd,
            "raster": {
                "origin": [float(x) for x in raster.origin],
                "spacing": float(raster.spacing),
                "shape": list(raster.sd.shape),
            },
            "volume": self.volume,
            "n_draws": len(draws),
        }
        if self.is_whole:
            table = self.walks.table
            arrays |= {f"table.{name}": getattr(table, name) for name in TABLE}
            arrays |= {f"table.{name}": arrays[f"table.{name}"].astype(np.int32) for name in ("first", "second")}
            arrays |= {f"tree.{name}": getattr(table.tree, name) for name in TREE}
            attributes["noise"] = asdict(self.walks.noise)
            attributes["live_noise"] = asdict(self.walks.live_noise)
            attributes["table"] = {name: float(getattr(table, name)) for name in TABLE_SCALARS}
        write_mapped(path, SCHEMA, attributes, arrays)


@dataclass(frozen=True, eq=False, slots=True)
class IndexFile:
    """An index on disk, opened but hardly read."""

    content: MappedArrays
    config: RegistrationConfig

    @property
    def is_whole(self) -> bool:
        """Whether it holds what walks need, too."""
        return "table" in self.content.attributes

    @property
    def volume(self) -> float:
        """Volume of the region that the map knows, m^3."""
        return float(self.content.attributes["volume"])

    def table(self) -> PairTable:
        """Pairs of points, read on demand; of a complete index."""
        arrays = self.content.arrays
        columns = {name: arrays[f"table.{name}"] for name in TABLE} | self.content.attributes["table"]
        tree = NeighbourTree(*(arrays[f"tree.{name}"] for name in TREE))
        return PairTable(tree=tree, **columns)

    def load(self, field_map: FieldMap) -> MapIndex:
        """Read all of it, given the map that it was made of; raises DataFormatError if it is damaged."""
        self.content.check()
        arrays, about = self.content.arrays, self.content.attributes
        survey = known_samples(field_map)
        base = PreparedMap(
            field_map=field_map,
            T_map_model=field_map.T_map_model,
            posterior=field_map.posterior,
            samples=survey.positions,
            sample_field=survey.field,
            raster=self._raster(),
            correlation_length=about["correlation_length"],
            noise_sd=about["noise_sd"],
            drift=Drift.of(survey, field_map.posterior),
            draws=cache(partial(_draws, arrays.get("draws"), field_map, about["n_draws"])),
            **{name: np.array(arrays[f"prepared.{name}"]) for name in PREPARED},
        )
        if not self.is_whole:
            return _index_over(base, self.config)
        table = self.table()
        noise, live_noise = PathNoise(**about["noise"]), PathNoise(**about["live_noise"])
        index = MapIndex(base, partial(WalkIndex, base, table.length, noise, live_noise, table))
        assert index.walks.table is table
        return index

    def _raster(self) -> Raster:
        arrays, about = self.content.arrays, self.content.attributes["raster"]
        return Raster.knowing(
            np.array(about["origin"]), about["spacing"], tuple(about["shape"]),
            arrays["raster.rows"], arrays["raster.field"], arrays["raster.sd"],
        )  # fmt: skip


def prepare_index(base: FieldMap | MapIndex, config: RegistrationConfig) -> MapIndex:
    """What any target needs of a base map; independent of the seed, so that a stored index gives the same answer."""
    if isinstance(base, MapIndex):
        return base
    # With more threads the order of sums changes, and an index would give other bits than the map itself.
    with one_blas_thread():
        prepared = prepare(base, config.invariants.n_draws, _base_rng())
    return _index_over(prepared, config)


def _index_over(base: PreparedMap, config: RegistrationConfig) -> MapIndex:
    return MapIndex(base, lambda: index_walks(base, config.walks.search, _base_rng()))


def _base_rng() -> np.random.Generator:
    return np.random.default_rng(0)


def _draws(kept: np.ndarray | None, field_map: FieldMap, n_draws: int) -> list[Any]:
    """Posterior samples as stored; those of a tiled map are drawn again when they are needed."""
    return list(field_map.posterior.draw_weights(n_draws, _base_rng()) if kept is None else np.array(kept))


def index_path(map_path: str | Path) -> Path:
    """Path of the index of a saved map: next to it, with ``.index`` added to its name."""
    path = Path(map_path)
    return path.with_name(path.name + SUFFIX)


def index_key(map_path: str | Path, config: RegistrationConfig) -> str:
    """What an index must have been made from to be valid: SHA-256 of map, settings and version."""
    made_with = {
        "map": fingerprint_archive(map_path),
        "n_draws": config.invariants.n_draws,
        "pairs": config.walks.search.model_dump(mode="json"),
        "version": __version__,
    }
    return hashlib.sha256(json.dumps(made_with, sort_keys=True).encode()).hexdigest()


def open_index(map_path: str | Path, config: RegistrationConfig) -> IndexFile | None:
    """Open the index of a saved map.

    None if there is none, or it was made from another map, with other settings or by another version; raises
    DataFormatError if the map itself is none.
    """
    key = index_key(map_path, config)
    try:
        content = open_mapped(index_path(map_path), SCHEMA)
    except DataFormatError as error:
        log.debug("no index: %s", error)
        return None
    return IndexFile(content, config) if content.attributes.get("key") == key else None


def make_index(
    map_path: str | Path,
    config: RegistrationConfig,
    field_map: FieldMap | None = None,
    *,
    progress: Progress | None = None,
) -> MapIndex:
    """Index a saved map and store the index next to it, if the folder is writable.

    Parameters
    ----------
    field_map : FieldMap, optional
        The map, if it was read already.
    progress : callable, optional
        Called with the current step and the fraction done; see `magmatch.progress`.
    """
    key = index_key(map_path, config)
    with one_blas_thread(), followed(progress):
        index = prepare_index(field_map or FieldMap.load(map_path), config)
        tell("listing pairs of points for walks")
        index.walks  # noqa: B018  # asked for, it is prepared
    try:
        index.save(index_path(map_path), key)
    except OSError as error:
        log.warning("the index of %s cannot be stored: %s", map_path, error)
    return index


def keep_index(map_path: str | Path, config: RegistrationConfig, index: MapIndex, key: str) -> bool:
    """Store what a registration computed from a saved map next to it; returns whether this was possible.

    ``key`` is that of `index_key` from before the map was read: where the file has changed since, nothing is kept.
    """
    try:
        if index_key(map_path, config) != key:
            return False
        index.save(index_path(map_path), key)
    except (OSError, DataFormatError) as error:
        log.debug("no index is stored: %s", error)
        return False
    return True
