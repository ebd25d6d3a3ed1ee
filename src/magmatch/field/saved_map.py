# SPDX-License-Identifier: BSD-3-Clause
"""A saved map holds its surveys, the hyperparameters of its prior, and the fitted weights, tile by tile.

Weights of splines are stored with a fingerprint of the samples they follow from, and are used as they are: loading
fits nothing. Whatever needs more than the mean (covariance, draws) factorises the tile it falls into again from its
samples, and so checks its weights. Models of other priors are fitted again on loading and checked against theirs.
"""

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any, NoReturn

import numpy as np
from scipy.spatial.transform import RigidTransform

from magmatch.data.survey import Survey
from magmatch.errors import DataFormatError, MagmatchError
from magmatch.field.config import FieldConfig
from magmatch.field.fit import fit_posterior
from magmatch.field.hyperparameters import Hyperparameters
from magmatch.field.linear_model import FieldPosterior, Index, StoredTile, is_refit
from magmatch.store import expect, naming, open_stored, save
from magmatch.typing import Scalars

SCHEMA = "magmatch.map/3"
# A prior lays its nodes over the samples' box: a file must not ask for more of them than a machine can hold.
MAX_NODES = 2e8
# Nodes beyond the box on each side that any prior may add.
MARGIN_NODES = 12
_OF_THREE = ("positions", "field")
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
        n = sum(map(len, self.surveys))
        if not n or len(self.fitted_samples) != n or bool(self.tiles) == bool(self.weights.size):
            msg = (
                f"expected as many fitted samples as the surveys have ({n}), and the weights of tiles or all weights"
            )
            raise ValueError(msg)
        arrays = {"positions": self.survey.positions, "field": self.survey.field, "weights": self.weights}
        for index, tile in self.tiles.items():
            name = "tile " + ".".join(map(str, index))
            if [type(k) for k in index] != [int] * 3 or not isinstance(tile, StoredTile):
                msg = f"entry '{name}': expected the weights of one tile with three indices, found {tile!r:.60}"
                raise ValueError(msg)
            arrays[name] = tile.weights
        for name, array in arrays.items():
            if array.dtype != np.float64 or not np.isfinite(array).all() or array.ndim != 1 + (name in _OF_THREE):
                msg = f"entry '{name}': expected finite numbers, found an array of shape {array.shape}"
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

    def restore(self, path: str | Path) -> FieldPosterior:
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
        content = {
            "surveys": self.surveys,
            "fitted_samples": Survey(self.fitted_samples.positions, self.fitted_samples.field, frame="model"),
            "T_map_model": self.T_map_model,
            "T_domain_model": self.T_domain_model,
            "config": self.config.model_dump(mode="json"),
            "hyperparameters": self.hyperparameters,
            "weights": self.weights,
            "tiles": list(self.tiles.items()),
        }
        save(path, SCHEMA, content)

    @classmethod
    def read(cls, path: str | Path) -> "MapRecord":
        """Read a saved map without fitting it: for its samples alone this is all that is needed."""
        stored = open_stored(path, SCHEMA, is_mapped=False)
        stored.check()
        content = stored.content((Hyperparameters, StoredTile, Survey), own=True)
        with naming(path):
            expect(
                content, surveys=[Survey], fitted_samples=Survey, T_map_model=RigidTransform,
                T_domain_model=RigidTransform, hyperparameters=Hyperparameters, weights=np.ndarray, tiles=[tuple],
            )  # fmt: skip
            content["config"] = FieldConfig.model_validate(content["config"])
            content["surveys"], content["tiles"] = tuple(content["surveys"]), dict(content["tiles"])
            return cls(**content, sha256=stored.sha256)


def _refuse_to_fit(*_: Any) -> NoReturn:
    """Stand in for running tasks where all weights should be stored already."""
    msg = f"entry 'tiles': {OTHER_FIELD}"
    raise ValueError(msg)
