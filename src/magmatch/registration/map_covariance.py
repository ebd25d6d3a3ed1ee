# SPDX-License-Identifier: BSD-3-Clause
"""How far a pose may be off because of what two maps do not know between their samples.

Such an error is alike all along a path beside another, so that a pose follows it and leaves no residual that would
show it (`covariance.py` lives on residuals). Draws from the maps' posteriors show it: each moves the pose by one
linear step.
"""

import numpy as np

from magmatch.geometry import rotate_vectors, transform_points
from magmatch.registration.prepared import PreparedMap
from magmatch.registration.refinement import (
    Lookup,
    RefinedPose,
    RefinementConfig,
    information_of,
    look_up,
    residual_jacobian,
    some_rows,
    student_weights,
)
from magmatch.typing import Covariance6, Matrix, Points, Vectors

N_DRAWS = 24


def map_covariance(
    base: PreparedMap, target: PreparedMap, pose: RefinedPose, config: RefinementConfig, seed: int
) -> Covariance6:
    """Covariance of a pose through the maps' own uncertainty alone.

    Parameters
    ----------
    base, target : PreparedMap
    pose : RefinedPose
        With a direction of comparison at least.
    config : RefinementConfig
    seed : int

    Returns
    -------
    (6, 6) array
        Of the perturbation about the pose's centre; rotation first (rad, m), target's model axes.
    """
    T, rng = pose.T_base_target, np.random.default_rng(seed)
    forward, backward = look_up(base, target, T, pose.sensor, some_rows(base, target, config, rng))
    information = information_of(pose.directions) + pose.known_before
    # The base's field enters the residual with a minus, the target's with a plus.
    of_base = [
        -rotate_vectors(error, T.inv()) for error in _errors(base, transform_points(forward.positions, T), rng)
    ]
    of_target = _errors(target, backward.positions, rng)
    scores = _scores(forward, target.noise_sd, pose, of_base) + _scores(backward, base.noise_sd, pose, of_target)
    moves = np.linalg.solve(information, scores.T)[:6]
    covariance: Covariance6 = moves @ moves.T / N_DRAWS
    return covariance


def _errors(of: PreparedMap, points: Points, rng: np.random.Generator) -> list[Vectors]:
    """How a map's field may differ from its mean at points: draws."""
    posterior = of.field_map.posterior
    mean = posterior.evaluate(points).field
    return [posterior.evaluate(points, 0, weights).field - mean for weights in posterior.draw_weights(N_DRAWS, rng)]


def _scores(lookup: Lookup, noise_sd: float, pose: RefinedPose, errors: list[Vectors]) -> Matrix:
    """Gradient of the likelihood that each draw adds: (draws, 6 + k)."""
    residual2 = np.einsum("ni,ni->n", lookup.residual, lookup.residual)
    weight, _ = student_weights(residual2, lookup.sd, noise_sd)
    JW = residual_jacobian(lookup, pose.center, pose.sensor) * weight[:, None, None]
    return np.stack([np.einsum("nij,ni->j", JW, error) for error in errors])
