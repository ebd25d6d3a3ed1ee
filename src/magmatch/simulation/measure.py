# SPDX-License-Identifier: BSD-3-Clause
"""A sensor reads the field along a path, and believes to be somewhere: the errors of a survey."""

import numpy as np

from magmatch.data.survey import Survey
from magmatch.simulation.config import SimulationConfig
from magmatch.simulation.magnets import Source, field_of
from magmatch.simulation.paths import SensorPath
from magmatch.typing import Points, Vector3, Vectors


def measure(
    path: SensorPath, sources: tuple[Source, ...], earth_field: Vector3, config: SimulationConfig,
    rng: np.random.Generator,
) -> Survey:  # fmt: skip
    """Measure along a path, world frame: the field where the sensor is, recorded where it thinks it is."""
    n = len(path.positions)
    # Drawn whether used or not, so that one setting does not change the others' errors.
    noise, pose_noise, steps = rng.standard_normal((n, 3)), rng.standard_normal((n, 3)), rng.standard_normal((n, 2))
    field = field_of(sources, path.positions) + earth_field
    drift, drift_sd = _drift(path.positions, steps, config.pose_drift)
    return Survey(
        positions=path.positions + config.pose_noise_sd * pose_noise + drift,
        field=_as_read(field, path, config) + config.noise_sd * noise,
        times=path.times,
        orientations=path.orientations,
        pose_sd=float(np.hypot(config.pose_noise_sd, drift_sd)),
    )


def _as_read(field: Vectors, path: SensorPath, config: SimulationConfig) -> Vectors:
    """Apply the sensor's scale and bias, which live in its own frame; result in the world frame."""
    bias = np.array(config.bias)
    turned = bias if path.orientations is None else path.orientations.apply(bias)
    return (1 + config.scale) * field + turned


def _drift(positions: Points, steps: np.ndarray, rate: float) -> tuple[Points, float]:
    """Random walk of horizontal positions about its own mean, which the frame takes up, and its mean deviation."""
    walked = np.linalg.norm(np.diff(positions, axis=0, prepend=positions[:1]), axis=1)
    walk = np.cumsum(rate * np.sqrt(walked)[:, None] * steps, axis=0)
    walk -= walk.mean(axis=0)
    # The variance of a random walk of length L about its own mean is L / 6 on average.
    return np.column_stack([walk, np.zeros(len(walk))]), rate * float(np.sqrt(walked.sum() / 6))
