# SPDX-License-Identifier: BSD-3-Clause
"""Localisation needs this of one map, computed once, in the map's model frame."""

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from magmatch.estimation.cubes import thin
from magmatch.estimation.path_noise import PathNoise
from magmatch.field.map import FieldMap
from magmatch.geometry import rotation_matrix
from magmatch.localization.config import LocalizerConfig
from magmatch.registration.index.map_index import MapIndex, prepare_index
from magmatch.typing import Covariance6, Matrix, Points, Scalars, Vector3

# Of a field length: spacing of the raster, short against what a tracked position is known to, and of the starts.
RASTER_SPACING, ANCHOR_SPACING = 0.125, 0.3
MAX_ANCHORS = 20_000
# Share of its field's variance that a map is taken to explain at least: none is worth nothing at all.
LEAST_EXPLAINED = 0.05
# Of a covariance's factors, every so many: a window's hundred readings tell no more apart.
FACTORS_EVERY = 4


class Ground(NamedTuple):
    """A raster (`magmatch.registration.prepared.raster`) as compiled loops take it, and the map's vertical."""

    values: np.ndarray
    origin: np.ndarray
    spacing: float
    up: np.ndarray


@dataclass(frozen=True, eq=False, slots=True)
class KnownMap:
    """A map prepared for localisation."""

    index: MapIndex
    name: str
    T_map_model: Matrix  # (4, 4)
    R_model_map: Matrix  # (3, 3)
    ground: Ground
    bent: Covariance6  # (6, 6): covariance of the map's own poses' errors, rotation first (rad, m)
    length: float  # m: field length
    noise: PathNoise  # covariance of another walk's residuals
    anchors: Points  # (a, 3), m: where a search begins: the map's own samples, thinned
    volume: float  # m^3: of all that is searched
    field_sd: float  # T: of one component over the map's samples
    field_rms: float  # T
    mean_field: Vector3  # T, model frame
    bias_spread: float  # T: of the biases of the map's own logs
    # Two (f,) arrays: `PathNoise.log_factors`, as many as a window's bins can tell apart
    log_factors: tuple[Scalars, Scalars]

    @property
    def up(self) -> Vector3:
        """The map's z, model frame."""
        return self.ground.up

    @property
    def dispersion(self) -> float:
        """By what a misfit is larger in a map that explains only a share of its field's variance.

        The model's errors are known by their spread only. Where they are as large as what is matched, a fit by chance
        is as likely as one by the field, and evidence counts by the share of the variance that the map explains.
        """
        errors = self.noise.misfit_sd**2 + self.noise.constant_sd**2
        return float(1 / np.sqrt(max(1 - errors / self.field_sd**2, LEAST_EXPLAINED)))

    def bias_sds(self, config: LocalizerConfig) -> tuple[float, float]:
        """Prior sd (T) of the bias of a sensor like those of the map's logs, and of one that was not calibrated."""
        return float(np.hypot(config.calibrated_bias_sd, self.bias_spread)), config.bias_sd

    @classmethod
    def of(cls, place: FieldMap | MapIndex) -> "KnownMap":
        """Make a map, or one that is indexed, ready."""
        index = prepare_index(place)
        base, noise = index.base, index.walks.live_noise
        raster = index.raster(RASTER_SPACING * index.length)
        anchors = base.samples[thin(base.samples, ANCHOR_SPACING * index.length, MAX_ANCHORS)]
        field_sd, values = float(np.sqrt(base.sample_field.var(axis=0).mean())), raster.values
        # A map that says nothing of a place still says how much its field varies.
        sd = values[..., 3]
        sd /= np.sqrt(1 + np.maximum(sd * noise.map_factor / field_sd, 0) ** 2)
        R = np.ascontiguousarray(rotation_matrix(base.T_map_model).T)
        # An error that a whole log of the map shares shows in none of its stretches: it counts as stated.
        place_sd = max(noise.drift_sd, base.field_map.survey.pose_sd)
        log_factors, log_priors = (np.ascontiguousarray(each[::FACTORS_EVERY]) for each in noise.log_factors())
        return cls(
            index,
            base.field_map.survey.name if base.field_map.file is None else base.field_map.file.path.name,
            base.T_map_model.as_matrix(),
            R,
            Ground(values, raster.origin, raster.spacing, np.ascontiguousarray(R[:, 2])),
            np.diag(np.repeat([noise.attitude_sd**2, place_sd**2], 3)),
            index.length,
            noise,
            np.ascontiguousarray(anchors),
            raster.volume,
            field_sd,
            float(np.sqrt((base.sample_field**2).mean())),
            base.sample_field.mean(axis=0),
            base.field_map.bias_spread,
            (log_factors, log_priors - np.logaddexp.reduce(log_priors)),
        )
