# SPDX-License-Identifier: BSD-3-Clause
"""What a saved map holds: its surveys, the numbers of its prior, and the fitted weights, tile by tile.

Weights of splines are stored with a fingerprint of the samples they follow from, and are used as they are: loading
fits nothing. Whatever needs more than the mean (covariance, draws) factorises the tile it falls into again from its
samples, and so checks its weights. Models of other priors are fitted again on loading and checked against theirs.
"""

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any, NoReturn

import numpy as np
from scipy.spatial.transform import RigidTransform, Rotation

from magmatch.data.survey import Survey
from magmatch.errors import DataFormatError, MagmatchError
from magmatch.field.config import FieldConfig
from magmatch.field.fit import fit_posterior
from magmatch.field.hyperparameters import Hyperparameters, is_number
from magmatch.field.linear_model import Index, Posterior, StoredTile, is_refit
from magmatch.store import naming, open_stored, save
from magmatch.typing import Scalars

SCHEMA = "magmatch.map/3"
# A prior lays its nodes over the samples' box: a file must not ask for more of them than a machine can hold.
MAX_NODES = 2e8
# Nodes beyond the box on each side that any prior may add.
MARGIN_NODES = 12
UNIT_QUATERNION_TOLERANCE = 1e-9
OTHER_FIELD = (
    "fitting its samples again gives another field (made by another version of magmatch?); the samples are intact: "
    "build the map again from this file's survey"
)


@dataclass(frozen=True, slots=True)
class MapFile:
    """The file that a map was read from."""

    path: Path
    sha256: str  # stands for the file's whole content

    @classmethod
    def of(cls, path: str | Path) -> "MapFile":
        """Look at a saved map without reading it; raises DataFormatError if it is none."""
        return cls(Path(path).absolute(), open_stored(path, SCHEMA).sha256)


@dataclass(frozen=True, eq=False, slots=True)
class MapRecord:
    """Content of a saved map."""

    surveys: tuple[Survey, ...]  # samples, map frame, in the order in which they were added
    T_map_model: RigidTransform  # takes model coordinates to map coordinates
    config: FieldConfig  # how the map was made, with the name of its prior
    hyperparameters: Hyperparameters  # resolved numbers of the prior
    weights: Scalars  # (m,): posterior mean of the weights, where they are not those of tiles; else empty
    # The same samples in the model's frame, exactly as they were fitted: to turn them there again would round
    # differently on another machine, and a basis laid over the samples may jump by a node for it
    fitted_samples: Survey
    T_domain_model: RigidTransform  # takes model coordinates to the frame of ``config.domain``
    tiles: Mapping[Index, StoredTile]  # weights of each tile of a spline model; a region without tiles is one
    sha256: str = ""  # of the file that it was read from

    @property
    def survey(self) -> Survey:
        """All samples, map frame."""
        return self.surveys[0].merged(*self.surveys[1:])

    def __post_init__(self) -> None:
        arrays = {"weights": self.weights, "positions": self.survey.positions, "field": self.survey.field}
        arrays |= {"model_positions": self.fitted_samples.positions, "model_field": self.fitted_samples.field}
        arrays |= {_tile_name(index): tile.weights for index, tile in self.tiles.items()}
        for name, array in arrays.items():
            if not np.isfinite(array).all():
                msg = f"expected finite {name}, got NaN or infinity"
                raise ValueError(msg)
        h = self.hyperparameters
        h.check()
        with np.errstate(over="ignore", invalid="ignore"):
            extent = np.ptp(self.fitted_samples.positions, axis=0)
            n_nodes = float(np.prod(extent / h.spacing + 2 * MARGIN_NODES))
        if not self.tiles and not n_nodes <= MAX_NODES:
            msg = (
                f"expected at most {MAX_NODES:.0e} nodes, got {n_nodes:.1e}: {extent} m at a spacing of {h.spacing} m"
            )
            raise ValueError(msg)

    def restore(self, path: str | Path) -> Posterior:
        """Posterior of the samples, once it is seen to be the one that was saved."""
        run = _refuse_to_fit if self.tiles else map
        try:
            posterior = fit_posterior(
                self.fitted_samples, self.hyperparameters, self.config, self.T_domain_model, self.tiles, run
            )
        except (ValueError, KeyError, np.linalg.LinAlgError, MagmatchError) as error:
            raise DataFormatError(path, f"its samples cannot be fitted again: {error}") from error
        if not self.tiles and not is_refit(posterior, self.weights, self.fitted_samples.positions):
            raise DataFormatError(path, f"entry 'weights': {OTHER_FIELD}")
        return posterior

    def write(self, path: str | Path) -> None:
        """Save the record; see `read`."""
        first, surveys = 0, []
        for survey in self.surveys:
            rows = slice(first, first := first + len(survey))
            surveys.append({
                "frame": survey.frame, "name": survey.name, "pose_sd": float(survey.pose_sd),
                "positions": survey.positions, "field": survey.field, "times": survey.times,
                "orientations": None if survey.orientations is None else survey.orientations.as_quat(),
                "model_positions": self.fitted_samples.positions[rows],
                "model_field": self.fitted_samples.field[rows],
            })  # fmt: skip
        content = {
            "surveys": surveys,
            "T_map_model": self.T_map_model,
            "T_domain_model": self.T_domain_model,
            "config": self.config.model_dump(mode="json"),
            "hyperparameters": self.hyperparameters.as_dict(),
            "weights": None if self.tiles else self.weights,
            "tiles": [[*index, tile.fingerprint, tile.weights] for index, tile in self.tiles.items()],
        }
        save(path, SCHEMA, content)

    @classmethod
    def read(cls, path: str | Path) -> "MapRecord":
        """Read a saved map without fitting it: for its samples alone this is all that is needed."""
        stored = open_stored(path, SCHEMA, is_mapped=False)
        stored.check()
        content = stored.content(own=True)
        with naming(path):
            surveys, tiles = content["surveys"], _tiles(content["tiles"])
            if not isinstance(surveys, list) or not surveys:
                msg = "entry 'surveys': expected a list"
                raise ValueError(msg)
            fitted = [_fitted_samples(k, one) for k, one in enumerate(surveys)]
            return cls(
                surveys=tuple(_survey(k, one) for k, one in enumerate(surveys)),
                T_map_model=_transform(content, "T_map_model"),
                config=FieldConfig.model_validate(content["config"]),
                hyperparameters=Hyperparameters.from_dict(content["hyperparameters"]),
                weights=np.zeros(0) if tiles else _shaped(content, "weights", "weights"),
                fitted_samples=fitted[0].merged(*fitted[1:]),
                T_domain_model=_transform(content, "T_domain_model"),
                tiles=tiles,
                sha256=stored.sha256,
            )


def _tile_name(index: Index) -> str:
    return "tile " + ".".join(map(str, index))


def _refuse_to_fit(*_: Any) -> NoReturn:
    """Stand in for running tasks where all weights should be stored already."""
    msg = f"entry 'tiles': {OTHER_FIELD}"
    raise ValueError(msg)


def _tiles(about: Any) -> dict[Index, StoredTile]:
    """Weights of all tiles, in the order of their indices."""
    tiles = {}
    for x, y, z, fingerprint, weights in about:
        if not all(type(n) is int for n in (x, y, z)) or not isinstance(fingerprint, str):
            msg = "entry 'tiles': expected the three indices, the fingerprint and the weights of each"
            raise ValueError(msg)
        tiles[x, y, z] = StoredTile(_shaped({"": weights}, "", _tile_name((x, y, z))), fingerprint)
    return dict(sorted(tiles.items()))


def _survey(k: int, about: Mapping[str, Any]) -> Survey:
    """Survey number k of a saved map, map frame."""
    orientations, times, place = None, None, f"surveys.{k}"
    if about["orientations"] is not None:
        quaternions = _shaped(about, "orientations", f"{place}.orientations", 4)
        if not np.allclose(np.linalg.norm(quaternions, axis=1), 1, rtol=0, atol=UNIT_QUATERNION_TOLERANCE):
            msg = f"entry '{place}.orientations': expected unit quaternions"
            raise ValueError(msg)
        # Unit already; to normalise once more would change their last bits.
        orientations = Rotation(quaternions, normalize=False)
    if about["times"] is not None:
        times = _shaped(about, "times", f"{place}.times")
    frame, name, pose_sd = about["frame"], about["name"], about["pose_sd"]
    if not (isinstance(frame, str) and isinstance(name, str) and is_number(pose_sd) and 0 <= pose_sd < np.inf):
        msg = f"entry '{place}': expected frame and name in words and pose_sd in metres"
        raise ValueError(msg)
    positions, field = (_shaped(about, name, f"{place}.{name}", 3) for name in ("positions", "field"))
    return Survey(positions, field, times, orientations, frame=frame, name=name, pose_sd=float(pose_sd))


def _fitted_samples(k: int, about: Mapping[str, Any]) -> Survey:
    """Samples of survey number k in the model's frame, as many as in the map frame."""
    names = ("model_positions", "model_field", "positions")
    positions, field, there = (_shaped(about, name, f"surveys.{k}.{name}", 3) for name in names)
    if len(positions) != len(there):
        msg = f"entry 'surveys.{k}.model_positions': expected as many samples as in 'positions'"
        raise ValueError(msg)
    return Survey(positions, field, frame="model")


def _shaped(about: Mapping[str, Any], name: str, place: str, n_columns: int | None = None) -> np.ndarray:
    """Float64 array of a saved map with the expected number of axes and columns, and at least one row."""
    array: Any = about[name]
    expected = "(n,)" if n_columns is None else f"(n, {n_columns})"
    is_array = isinstance(array, np.ndarray) and array.dtype == np.float64 and array.size > 0
    if not is_array or array.ndim != (1 if n_columns is None else 2) or array.shape[1:] not in {(), (n_columns,)}:
        found = array.shape if isinstance(array, np.ndarray) else type(array).__name__
        msg = f"entry '{place}': expected an array of shape {expected}, found {found}"
        raise ValueError(msg)
    return np.asarray(array)


def _transform(content: Mapping[str, Any], name: str) -> RigidTransform:
    value = content[name]
    if not isinstance(value, RigidTransform):
        msg = f"entry '{name}': expected a rigid transform, found {value!r:.60}"
        raise TypeError(msg)
    return value
