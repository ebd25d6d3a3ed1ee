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
from magmatch.field.storage.archive import naming_entries, read_archive, write_archive
from magmatch.field.storage.archive_checks import look_into
from magmatch.geometry import transform_from_matrix
from magmatch.typing import Scalars

SCHEMA = "magmatch.map/2"
# A prior lays its nodes over the samples' box: a file must not ask for more of them than a machine can hold.
MAX_NODES = 2e8
# Nodes beyond the box on each side that any prior may add.
MARGIN_NODES = 12
UNIT_QUATERNION_TOLERANCE = 1e-9
OTHER_FIELD = (
    "fitting its samples again gives another field (made by another version of magmatch?); the samples are intact: "
    "build the map again from this file's survey"
)


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

    @property
    def survey(self) -> Survey:
        """All samples, map frame."""
        return self.surveys[0].merged(*self.surveys[1:])

    def __post_init__(self) -> None:
        for name, array in self.arrays().items():
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

    def arrays(self) -> dict[str, np.ndarray]:
        """Arrays of the file by their names."""
        arrays: dict[str, np.ndarray] = {} if self.tiles else {"weights": self.weights}
        arrays |= {tile_name(index): tile.weights for index, tile in self.tiles.items()}
        first = 0
        for k, survey in enumerate(self.surveys):
            rows = slice(first, first := first + len(survey))
            arrays |= {f"positions.{k}": survey.positions, f"field.{k}": survey.field}
            arrays |= {f"model_positions.{k}": self.fitted_samples.positions[rows]}
            arrays |= {f"model_field.{k}": self.fitted_samples.field[rows]}
            if survey.times is not None:
                arrays[f"times.{k}"] = survey.times
            if survey.orientations is not None:
                arrays[f"orientations.{k}"] = survey.orientations.as_quat()
        return arrays

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
        attributes = {
            "surveys": [{"frame": s.frame, "name": s.name, "pose_sd": float(s.pose_sd)} for s in self.surveys],
            "tiles": {tile_name(index): tile.fingerprint for index, tile in self.tiles.items()},
            # SciPy keeps a rigid transform as this very matrix, so no quaternion is needed for an exact copy.
            "T_map_model": self.T_map_model.as_matrix().tolist(),
            "T_domain_model": self.T_domain_model.as_matrix().tolist(),
            "config": self.config.model_dump(mode="json"),
            "hyperparameters": self.hyperparameters.as_dict(),
        }
        write_archive(path, SCHEMA, attributes, self.arrays())

    @classmethod
    def read(cls, path: str | Path) -> "MapRecord":
        """Read a saved map without fitting it: for its samples alone this is all that is needed."""
        attributes, arrays = read_archive(path, SCHEMA)
        for name in ("surveys", "tiles", "T_map_model", "T_domain_model", "config", "hyperparameters"):
            if name not in attributes:
                raise DataFormatError(path, f"entry 'zarr.json': attribute '{name}' is missing")
        with naming_entries(path):
            return cls(
                surveys=_surveys(attributes["surveys"], arrays),
                T_map_model=_transform(attributes, "T_map_model"),
                config=FieldConfig.model_validate(attributes["config"]),
                hyperparameters=Hyperparameters.from_dict(attributes["hyperparameters"]),
                weights=np.zeros(0) if attributes["tiles"] else _shaped(arrays, "weights", 1),
                fitted_samples=_fitted_samples(len(attributes["surveys"]), arrays),
                T_domain_model=_transform(attributes, "T_domain_model"),
                tiles=_tiles(attributes["tiles"], arrays),
            )


def tile_name(index: Index) -> str:
    """What the weights of a tile are called in a file."""
    return "tile." + ".".join(map(str, index))


def _refuse_to_fit(*_: Any) -> NoReturn:
    """Stand in for running tasks where all weights should be stored already."""
    msg = f"entries 'tile.*': {OTHER_FIELD}"
    raise ValueError(msg)


def _tiles(about: Any, arrays: Mapping[str, np.ndarray]) -> dict[Index, StoredTile]:
    """Weights of all tiles that the attributes list, and no others."""
    held = {name for name in arrays if name.startswith("tile.")}
    if not isinstance(about, dict) or not all(isinstance(value, str) for value in about.values()):
        msg = "entry 'zarr.json', tiles: expected the fingerprint of each tile"
        raise ValueError(msg)
    for name in sorted(held ^ about.keys()):
        raise KeyError(name)
    tiles = {}
    for name, fingerprint in about.items():
        try:
            _, x, y, z = name.split(".")
            index = (int(x), int(y), int(z))
        except ValueError:
            msg = f"entry 'zarr.json', tiles: expected names such as tile.0.-1.0, found {name[:60]!r}"
            raise ValueError(msg) from None
        tiles[index] = StoredTile(_shaped(arrays, name, 1), fingerprint)
    return dict(sorted(tiles.items()))


def _surveys(about: Any, arrays: Mapping[str, np.ndarray]) -> tuple[Survey, ...]:
    """Surveys of a saved map, map frame."""
    if not isinstance(about, list) or not about:
        msg = "entry 'zarr.json', surveys: expected a list"
        raise ValueError(msg)
    return tuple(_survey(k, one, arrays) for k, one in enumerate(about))


def _survey(k: int, about: Any, arrays: Mapping[str, np.ndarray]) -> Survey:
    """One survey of a saved map, map frame."""
    orientations = None
    if f"orientations.{k}" in arrays:
        quaternions = _shaped(arrays, f"orientations.{k}", 2, 4)
        if not np.allclose(np.linalg.norm(quaternions, axis=1), 1, rtol=0, atol=UNIT_QUATERNION_TOLERANCE):
            msg = f"entry 'orientations.{k}': expected unit quaternions"
            raise ValueError(msg)
        # Unit already; to normalise once more would change their last bits.
        orientations = Rotation(quaternions, normalize=False)
    frame, name, pose_sd = (look_into(about, key) for key in ("frame", "name", "pose_sd"))
    if not (isinstance(frame, str) and isinstance(name, str) and is_number(pose_sd) and 0 <= pose_sd < np.inf):
        msg = "entry 'zarr.json', surveys: expected frame and name in words and pose_sd in metres"
        raise ValueError(msg)
    return Survey(
        positions=_shaped(arrays, f"positions.{k}", 2, 3),
        field=_shaped(arrays, f"field.{k}", 2, 3),
        times=_shaped(arrays, f"times.{k}", 1) if f"times.{k}" in arrays else None,
        orientations=orientations,
        frame=frame,
        name=name,
        pose_sd=float(pose_sd),
    )


def _fitted_samples(n_surveys: int, arrays: Mapping[str, np.ndarray]) -> Survey:
    """All samples in the model's frame, as many of each survey as in the map frame."""
    parts = []
    for k in range(n_surveys):
        positions, field = (_shaped(arrays, f"model_{name}.{k}", 2, 3) for name in ("positions", "field"))
        if len(positions) != len(arrays[f"positions.{k}"]):
            msg = f"entry 'model_positions.{k}': expected as many samples as in 'positions.{k}'"
            raise ValueError(msg)
        parts.append(Survey(positions, field, frame="model"))
    return parts[0].merged(*parts[1:])


def _shaped(arrays: Mapping[str, np.ndarray], name: str, n_axes: int, n_columns: int | None = None) -> np.ndarray:
    """Array of a saved map with the expected number of axes and columns, and at least one row."""
    array = arrays[name]
    if array.ndim != n_axes or len(array) == 0 or (n_columns is not None and array.shape[1] != n_columns):
        expected = "(n,)" if n_columns is None else f"(n, {n_columns})"
        msg = f"entry '{name}': expected an array of shape {expected}, found {array.shape}"
        raise ValueError(msg)
    return array


def _transform(attributes: Mapping[str, Any], name: str) -> RigidTransform:
    """Rigid motion from nested lists."""
    value = attributes[name]
    is_matrix = isinstance(value, list) and all(isinstance(row, list) and len(row) == 4 for row in value)
    try:
        if is_matrix and all(is_number(number) for row in value for number in row):
            return transform_from_matrix(np.array(value, dtype=np.float64))
        found = "expected a 4x4 matrix of numbers"
    except ValueError as error:
        found = str(error)
    msg = f"entry 'zarr.json', {name}: {found}"
    raise ValueError(msg)
