# SPDX-License-Identifier: BSD-3-Clause
"""How well fields are mapped: each prior and peer predicts what was held out, from the same samples."""

import math
from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from magmatch.data.survey import Survey
from magmatch.field.build import build_map
from magmatch.field.config import FieldConfig
from magmatch.field.map import FieldMap
from magmatch.simulation.config import SimulationConfig
from magmatch.simulation.scenarios import build_scene
from magmatch.simulation.scene import Streams
from magmatch.simulation.simulate import simulate
from magmatch.typing import Points, Tensors, Vectors
from magmatch_evaluation.baselines.interpolation import inverse_distance, local_gp, nearest_neighbour
from magmatch_evaluation.survey_pairs import load

# Step of differences that give a gradient where there is no formula, m.
STEP = 1e-3
N_QUERIES = 400


@dataclass(frozen=True, eq=False, slots=True)
class HeldOut:
    """Samples to learn from, and field (T) and gradient (T/m, None where unknown) at other points (m).

    ``is_noisy`` says that the field at the queries was measured rather than computed; ``rest`` are these samples, if
    the sensor of the survey measured them, with its bias.
    """

    survey: Survey
    queries: Points
    field: Vectors
    gradient: Tensors | None
    is_noisy: bool
    rest: Survey | None = None


@dataclass(frozen=True, slots=True)
class SimulatedField:
    """A scenario's base survey; queries in the box of its samples, `above` it (m) where it is a plane."""

    scenario: str
    config: SimulationConfig = field(default_factory=SimulationConfig)
    above: float = 0.0

    def __call__(self, seed: int, recordings: Path | None = None) -> HeldOut:  # noqa: ARG002  (as the recorded one)
        """Give samples and truth of a seed."""
        survey = simulate(self.scenario, seed, self.config).base
        scene = build_scene(self.scenario, self.config, Streams(seed))
        rng = np.random.default_rng([seed, 2])
        # Within the cloud of samples: a little off a sample drawn at random, so that no query lies in furniture.
        some = survey.positions[rng.choice(len(survey), N_QUERIES, replace=False)]
        queries = some + 0.03 * rng.standard_normal(some.shape) + [0.0, 0.0, self.above]
        gradient = differences(scene.base_field, queries)
        return HeldOut(survey, queries, scene.base_field(queries), gradient, is_noisy=False)


@dataclass(frozen=True, slots=True)
class RecordedField:
    """One recording predicts another, or the rest of itself a tenth of it in one piece (by seed)."""

    dataset: str
    training: str
    test: str | None = None
    every: int = 1

    def __call__(self, seed: int, recordings: Path | None = None) -> HeldOut:
        """Give samples and what was measured elsewhere."""
        surveys = load(self.dataset, recordings)
        survey = surveys[self.training]
        survey = survey.subset(np.arange(0, len(survey), self.every))
        if self.test is not None:
            other = surveys[self.test]
        else:
            is_out = np.arange(len(survey)) * 10 // len(survey) == (3 * seed + 2) % 10
            survey, other = survey.subset(~is_out), survey.subset(is_out)
        rows = np.linspace(0, len(other) - 1, min(len(other), 10 * N_QUERIES)).astype(int)
        other = other.subset(rows)
        rest = other if self.test is None else None
        return HeldOut(survey, other.positions, other.field, None, is_noisy=True, rest=rest)


@dataclass(frozen=True, slots=True)
class Predictor:
    """A prior of this package, or a peer: ``predict(points, field, queries)``, which is not in the ``repr``."""

    name: str
    predict: Callable[[Points, Vectors, Points], Vectors] | None = field(default=None, repr=False)
    has_gradient: bool = True
    module: str | None = None

    @property
    def title(self) -> str:
        """The kind of predictor in a few words."""
        return f"prior '{self.name}' of this package" if self.predict is None else "what one would use instead"

    def __call__(self, held_out: HeldOut) -> tuple[float, float, float]:
        """Root mean square errors of field (T) and gradient (T/m), and coverage of 95 % intervals; NaN for none."""
        survey, queries = held_out.survey, held_out.queries
        gradient, coverage = None, math.nan
        if (predict := self.predict) is not None:
            mean = predict(survey.positions, survey.field, queries)
            if held_out.gradient is not None and self.has_gradient:
                gradient = differences(lambda p: predict(survey.positions, survey.field, p), queries)
        else:
            field_map = build_map(survey, FieldConfig.model_validate({"prior": self.name}))
            values = field_map.evaluate(queries, order=1)
            mean, gradient = values.field + read_beside(field_map, held_out.rest), values.gradient
            variance = np.diagonal(field_map.covariance(queries), axis1=1, axis2=2)
            variance = variance + (field_map.hyperparameters.noise_sd**2 if held_out.is_noisy else 0.0)
            coverage = float(np.mean(np.abs(mean - held_out.field) < 1.96 * np.sqrt(variance)))
        field_rmse = float(np.sqrt(((mean - held_out.field) ** 2).sum(axis=1).mean()))
        if gradient is None or held_out.gradient is None:
            return field_rmse, math.nan, coverage
        return field_rmse, float(np.sqrt(((gradient - held_out.gradient) ** 2).sum(axis=(1, 2)).mean())), coverage


def read_beside(field_map: FieldMap, rest: Survey | None) -> Vectors:
    """Bias of the sensor of a map's only log, T: readings hold it, and the map does not."""
    if rest is None or field_map.biases is None:
        return np.zeros(3)
    (unbiased,) = field_map.biases.without([rest])
    return np.asarray(rest.field - unbiased.field)


PREDICTORS: dict[str, Predictor] = {
    predictor.name: predictor
    for predictor in (
        *map(Predictor, ("spline", "divergence_free", "curl_free", "harmonic")),
        # A peer that copies samples has no gradient.
        Predictor("nearest", nearest_neighbour, has_gradient=False),
        Predictor("idw", inverse_distance, has_gradient=False),
        Predictor("local-gp", local_gp),
    )
}


def differences(function: Callable[[Points], Vectors], points: Points) -> Tensors:
    """Gradient (n, 3, 3) of a vector field at points by central differences, ``[i, a, b] = dB_a / dx_b``."""
    steps = STEP * np.concatenate([np.eye(3), -np.eye(3)])
    # In one call: a model that is fitted on every call is fitted once.
    values = function((points + steps[:, None]).reshape(-1, 3)).reshape(6, -1, 3)
    gradient: Tensors = np.stack(list((values[:3] - values[3:]) / (2 * STEP)), axis=2)
    return gradient
