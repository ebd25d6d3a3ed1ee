# SPDX-License-Identifier: BSD-3-Clause
"""A search needs this of one map, computed once, in the map's own model frame.

The model frame moves with the survey, which makes the answer equivariant under rigid motions.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from scipy.spatial.transform import RigidTransform
from scipy.special import chdtri

from magmatch.data.checks import MIN_SAMPLES
from magmatch.data.survey import Survey
from magmatch.errors import SurveyError
from magmatch.estimation.cubes import SAMPLING, thin
from magmatch.features.invariants import rotation_invariants, traceless_symmetric
from magmatch.field.map import FieldMap
from magmatch.field.values import FieldFunction, FieldValues, gradient_norm, gradient_of
from magmatch.progress import tell
from magmatch.registration.prepared.drift import Drift
from magmatch.registration.prepared.raster import Raster, rasterize
from magmatch.typing import Indices, Matrix, Points, Scalars, Tensors, Vectors

# Medians of chi-square variables: robust variance from squared norms of a vector, and of a traceless symmetric
# gradient, which has five independent components.
MEDIAN_CHI2_3, MEDIAN_CHI2_5 = (float(chdtri(n, 0.5)) for n in (3, 5))


@dataclass(frozen=True, eq=False, slots=True)
class PreparedMap:
    """A field map made ready for matching; all arrays are in its model frame."""

    field_map: FieldMap
    T_map_model: RigidTransform
    posterior: FieldFunction  # the map's field
    samples: Points  # (n, 3), m
    sample_field: Vectors  # (n, 3), T: measured vectors
    points: Points  # (k, 3), m: thinned sample positions that carry frames and invariants
    point_field: Vectors  # (k, 3), T
    point_gradient: Tensors  # (k, 3, 3), T/m: posterior mean, made symmetric and traceless
    gradient_sd: Scalars  # (k,), T/m: spread of the gradient's norm under the posterior
    # (k, 6) each: see `magmatch.features.invariants`
    invariants: Matrix
    invariant_sd: Matrix
    raster: Raster
    # m: distance over which the field changes by as much as it varies overall: the scale of all steps, cells and
    # tolerances. The prior's own lengthscale measures smoothness instead.
    correlation_length: float
    noise_sd: float  # T
    drift: Drift  # errors of its samples' positions
    # Gives posterior samples of the map, for `posterior.evaluate`; the same ones at every call
    draws: Callable[[], Sequence[Any]]

    def part(self, rows: Indices) -> "PreparedMap":
        """Take some of the map's samples, for comparing them with another map."""
        drift = replace(self.drift, stretch=self.drift.stretch[rows])
        return replace(self, samples=self.samples[rows], sample_field=self.sample_field[rows], drift=drift)


def prepare(field_map: FieldMap, n_draws: int, rng: np.random.Generator) -> PreparedMap:
    """Evaluate everything that a search needs of a map; posterior samples give the spread of derived quantities."""
    tell(f"evaluating the map of {field_map.survey.name}")
    survey = known_samples(field_map)
    posterior = field_map.posterior
    some = survey.positions[thin(survey.positions, field_map.hyperparameters.spacing / 2)]
    # At least the scale of the map's basis: for a constant field the ratio would be rounding error only.
    correlation_length = max(
        correlation_length_of(posterior.evaluate(some, order=1)), field_map.hyperparameters.spacing
    )
    points = survey.positions[thin(survey.positions, SAMPLING / 2 * correlation_length)]
    mean = posterior.evaluate(points, order=1)
    weights = list(posterior.draw_weights(n_draws, rng))
    draws = [posterior.evaluate(points, 1, w) for w in weights]
    gradient = _harmonic_gradient(mean)
    invariants = rotation_invariants(mean.field, gradient)
    spread = [rotation_invariants(d.field, _harmonic_gradient(d)) - invariants for d in draws]
    gradient_spread = [gradient_norm(_harmonic_gradient(d) - gradient) for d in draws]
    return PreparedMap(
        field_map=field_map,
        T_map_model=field_map.T_map_model,
        posterior=posterior,
        samples=survey.positions,
        sample_field=survey.field,
        points=points,
        point_field=mean.field,
        point_gradient=gradient,
        gradient_sd=np.sqrt(np.mean(np.square(gradient_spread), axis=0)),
        invariants=invariants,
        invariant_sd=np.sqrt(np.mean(np.square(spread), axis=0)),
        raster=rasterize(field_map, SAMPLING * correlation_length, weights),
        correlation_length=correlation_length,
        noise_sd=field_map.hyperparameters.noise_sd,
        drift=Drift.of(survey, posterior),
        draws=lambda: weights,
    )


def known_samples(field_map: FieldMap) -> Survey:
    """The map's samples in its model frame; only those inside the box, if one was declared."""
    survey = field_map.survey
    if field_map.config.domain is not None:
        survey = survey.subset(field_map.knows(survey.positions))
        if len(survey) < MIN_SAMPLES:
            msg = f"'{survey.name}': {len(survey)} samples lie in the map's domain, expected at least {MIN_SAMPLES}"
            raise SurveyError(msg)
    return survey.transformed(field_map.T_map_model.inv())


def common_length(base: PreparedMap, target: PreparedMap) -> float:
    """The shorter of two correlation lengths, m: the scale at which a pair is compared."""
    return min(base.correlation_length, target.correlation_length)


def height_range(base: PreparedMap) -> float:
    """Range of heights, in its survey frame, over which a map knows the field, m."""
    return float(np.ptp(base.T_map_model.apply(base.samples)[:, 2]) + base.correlation_length)


def correlation_length_of(values: FieldValues) -> float:
    """Distance over which a field changes by as much as it varies overall: its spread divided by its gradient."""
    deviation2 = ((values.field - np.median(values.field, axis=0)) ** 2).sum(axis=1)
    g2 = gradient_norm(_harmonic_gradient(values)) ** 2
    # For a squared-exponential potential, each component of the gradient has twice the field's variance per l^2.
    return float(np.sqrt(np.median(deviation2) / MEDIAN_CHI2_3 / max(np.median(g2) / (2 * MEDIAN_CHI2_5), 1e-30)))


def _harmonic_gradient(values: FieldValues) -> Tensors:
    return traceless_symmetric(gradient_of(values))
