# SPDX-License-Identifier: BSD-3-Clause
"""What a saved map holds: its samples, the numbers of its prior, and the fitted weights to check against.

The posterior itself is not stored: it is fitted again on loading. That takes one factorisation, is bit for bit
what was built (the same function on the same numbers), needs no layout per prior, and leaves nothing in the file
that could disagree with the samples unseen; the stored mean shows whether the fit is still the one that was saved.
"""

from collections.abc import Mapping
from dataclasses import MISSING, dataclass, fields
from pathlib import Path
from typing import Any

import numpy as np
from pydantic import ValidationError
from scipy.spatial.transform import RigidTransform, Rotation

from magmatch.data.survey import Survey
from magmatch.errors import DataFormatError, MagmatchError
from magmatch.field.archive import read_archive, write_archive
from magmatch.field.config import FieldConfig
from magmatch.field.fit import fit_posterior
from magmatch.field.hyperparameters import Hyperparameters
from magmatch.field.linear_model import Posterior
from magmatch.geometry import transform_from_matrix
from magmatch.typing import Scalars

SCHEMA = "magmatch.map/1"
# A prior lays its nodes over the samples' box: a file must not ask for more of them than a machine can hold.
MAX_NODES = 2e8
# Nodes beyond the box on each side that any prior may add.
MARGIN_NODES = 12
UNIT_QUATERNION_TOLERANCE = 1e-9
# Largest change of the mean field at the samples that another machine's rounding may make, in noise_sd.
REFIT_TOLERANCE = 1e-6
# Samples at which the refitted field is compared with the saved one.
N_CHECKED = 2000


@dataclass(frozen=True, eq=False, slots=True)
class MapRecord:
    """Content of a saved map.

    Attributes
    ----------
    survey : Survey
        Samples, map frame.
    T_map_model : RigidTransform
        Takes model coordinates to map coordinates.
    config : FieldConfig
        How the map was made, with the name of its prior.
    hyperparameters : Hyperparameters
        Resolved numbers of the prior.
    weights : (m,) array
        Posterior mean of the weights.
    fitted_samples : Survey
        The same samples in the model's frame, exactly as they were fitted: to turn them there again would round
        differently on another machine, and a basis laid over the samples may jump by a node for it.
    T_domain_model : RigidTransform
        Takes model coordinates to the frame of ``config.domain``.
    """

    survey: Survey
    T_map_model: RigidTransform
    config: FieldConfig
    hyperparameters: Hyperparameters
    weights: Scalars
    fitted_samples: Survey
    T_domain_model: RigidTransform

    def __post_init__(self) -> None:
        for name, value in self._numbers().items():
            if not np.isfinite(value).all():
                msg = f"expected finite {name}, got NaN or infinity"
                raise ValueError(msg)
        h = self.hyperparameters
        if min(h.lengthscale, h.signal_sd, h.noise_sd, h.spacing) <= 0:
            msg = f"expected positive lengthscale, signal_sd, noise_sd and spacing, got {h}"
            raise ValueError(msg)
        with np.errstate(over="ignore", invalid="ignore"):
            extent = np.ptp(self.fitted_samples.positions, axis=0)
            n_nodes = float(np.prod(extent / h.spacing + 2 * MARGIN_NODES))
        if not n_nodes <= MAX_NODES:
            msg = (
                f"expected at most {MAX_NODES:.0e} nodes, got {n_nodes:.1e}: {extent} m at a spacing of {h.spacing} m"
            )
            raise ValueError(msg)

    def _numbers(self) -> dict[str, Any]:
        """All numbers that must be finite."""
        survey = self.survey
        numbers = {"positions": survey.positions, "field": survey.field, "pose_sd": survey.pose_sd}
        numbers |= {"model_positions": self.fitted_samples.positions, "model_field": self.fitted_samples.field}
        numbers |= {"weights": self.weights, "T_map_model": self.T_map_model.as_matrix()}
        numbers |= {"T_domain_model": self.T_domain_model.as_matrix()}
        numbers |= self.hyperparameters.as_dict()
        if survey.times is not None:
            numbers["times"] = survey.times
        return numbers

    def refit(self, path: str | Path) -> Posterior:
        """Fit the samples again and make sure that the field is the one that was saved.

        Parameters
        ----------
        path : path
            Where the record came from, for messages.

        Returns
        -------
        Posterior

        Raises
        ------
        DataFormatError
            The samples cannot be fitted, or give another field.
        """
        try:
            posterior = fit_posterior(self.fitted_samples, self.hyperparameters, self.config, self.T_domain_model)
        except (ValueError, KeyError, np.linalg.LinAlgError, MagmatchError) as error:
            raise DataFormatError(path, f"its samples cannot be fitted again: {error}") from error
        if not _is_same_field(posterior, self.weights, self.fitted_samples):
            raise DataFormatError(
                path,
                "entry 'weights': fitting its samples again gives another field (made by another version of "
                "magmatch?); the samples are intact: build the map again from this file's survey",
            )
        return posterior

    def write(self, path: str | Path) -> None:
        """Save the record; see `read`."""
        survey = self.survey
        arrays = {"positions": survey.positions, "field": survey.field, "weights": self.weights}
        arrays |= {"model_positions": self.fitted_samples.positions, "model_field": self.fitted_samples.field}
        if survey.times is not None:
            arrays["times"] = survey.times
        if survey.orientations is not None:
            arrays["orientations"] = survey.orientations.as_quat()
        attributes = {
            "survey": {"frame": survey.frame, "name": survey.name, "pose_sd": float(survey.pose_sd)},
            # SciPy keeps a rigid transform as this very matrix, so no quaternion is needed for an exact copy.
            "T_map_model": self.T_map_model.as_matrix().tolist(),
            "T_domain_model": self.T_domain_model.as_matrix().tolist(),
            "config": self.config.model_dump(mode="json"),
            "hyperparameters": {name: float(value) for name, value in self.hyperparameters.as_dict().items()},
        }
        write_archive(path, SCHEMA, attributes, {n: np.asarray(a, dtype=np.float64) for n, a in arrays.items()})

    @classmethod
    def read(cls, path: str | Path) -> "MapRecord":
        """Read a saved map without fitting it: for its samples alone this is all that is needed.

        Parameters
        ----------
        path : path
            A saved map.

        Returns
        -------
        MapRecord

        Raises
        ------
        DataFormatError
            Not a map, damaged, or of another version; names the entry.
        """
        attributes, arrays = read_archive(path, SCHEMA)
        for name in ("survey", "T_map_model", "T_domain_model", "config", "hyperparameters"):
            if name not in attributes:
                raise DataFormatError(path, f"entry 'zarr.json': attribute '{name}' is missing")
        try:
            return cls(
                survey=_survey(attributes["survey"], arrays),
                T_map_model=_transform(attributes, "T_map_model"),
                config=FieldConfig.model_validate(attributes["config"]),
                hyperparameters=_hyperparameters(attributes["hyperparameters"]),
                weights=_shaped(arrays, "weights", 1),
                fitted_samples=_fitted_samples(arrays),
                T_domain_model=_transform(attributes, "T_domain_model"),
            )
        except KeyError as error:
            raise DataFormatError(path, f"entry '{error.args[0]}' is missing") from None
        except ValidationError as error:
            first = error.errors()[0]
            place = ".".join(str(p) for p in first["loc"])
            raise DataFormatError(path, f"entry 'zarr.json', config.{place}: {first['msg']}") from None
        except (ValueError, TypeError, OverflowError) as error:
            raise DataFormatError(path, " ".join(str(error).split())) from None


def _is_same_field(posterior: Posterior, weights: Scalars, samples: Survey) -> bool:
    """Whether two means agree where there are data, but for rounding."""
    if weights.shape != posterior.weights.shape:
        return False
    if np.array_equal(weights, posterior.weights):
        return True
    points = samples.positions[:: -(-len(samples) // N_CHECKED)]
    change = posterior.evaluate(points).field - posterior.evaluate(points, weights=weights).field
    return bool(np.abs(change).max() <= REFIT_TOLERANCE * posterior.hyperparameters.noise_sd)


def _survey(about: Any, arrays: Mapping[str, np.ndarray]) -> Survey:
    """Samples of a saved map, map frame."""
    orientations = None
    if "orientations" in arrays:
        quaternions = _shaped(arrays, "orientations", 2, 4)
        if not np.allclose(np.linalg.norm(quaternions, axis=1), 1, rtol=0, atol=UNIT_QUATERNION_TOLERANCE):
            msg = "entry 'orientations': expected unit quaternions"
            raise ValueError(msg)
        # Unit already; to normalise once more would change their last bits.
        orientations = Rotation(quaternions, normalize=False)
    frame, name, pose_sd = (_at(about, key) for key in ("frame", "name", "pose_sd"))
    if not (isinstance(frame, str) and isinstance(name, str) and _is_number(pose_sd) and pose_sd >= 0):
        msg = "entry 'zarr.json', survey: expected frame and name in words and pose_sd in metres"
        raise ValueError(msg)
    return Survey(
        positions=_shaped(arrays, "positions", 2, 3),
        field=_shaped(arrays, "field", 2, 3),
        times=_shaped(arrays, "times", 1) if "times" in arrays else None,
        orientations=orientations,
        frame=frame,
        name=name,
        pose_sd=float(pose_sd),
    )


def _fitted_samples(arrays: Mapping[str, np.ndarray]) -> Survey:
    return Survey(_shaped(arrays, "model_positions", 2, 3), _shaped(arrays, "model_field", 2, 3), frame="model")


def _hyperparameters(about: Any) -> Hyperparameters:
    """Numbers by name, none unknown; those that came later take their default in older files."""
    known = {f.name for f in fields(Hyperparameters)}
    required = {f.name for f in fields(Hyperparameters) if f.default is MISSING}
    found = about if isinstance(about, dict) else {}
    if not required <= found.keys() <= known or not all(map(_is_number, found.values())):
        msg = f"entry 'zarr.json', hyperparameters: expected numbers for {', '.join(sorted(known))}"
        raise ValueError(msg)
    return Hyperparameters(**{name: float(value) for name, value in found.items()})


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
        if is_matrix and all(_is_number(number) for row in value for number in row):
            return transform_from_matrix(np.array(value, dtype=np.float64))
        found = "expected a 4x4 matrix of numbers"
    except ValueError as error:
        found = str(error)
    msg = f"entry 'zarr.json', {name}: {found}"
    raise ValueError(msg)


def _at(value: Any, key: str) -> Any:
    return value.get(key) if isinstance(value, dict) else None


def _is_number(value: Any) -> bool:
    return isinstance(value, int | float) and not isinstance(value, bool)
