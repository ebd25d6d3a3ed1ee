# SPDX-License-Identifier: BSD-3-Clause
"""Covariance of a pose due to the uncertainty of two maps between their samples.

Along a path beside another, such an error is nearly constant, so the pose follows it and no residual shows it
(`covariance.py` uses residuals only). Draws from the maps' posteriors show it: each shifts the pose by one linear
step.
"""

import numpy as np

from magmatch.geometry import rotate_vectors, transform_points
from magmatch.registration.prepared.prepared_map import PreparedMap
from magmatch.registration.refine.refinement import (
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


def map_covariance(
    base: PreparedMap, target: PreparedMap, pose: RefinedPose, config: RefinementConfig, seed: int
) -> Covariance6:
    """Covariance of a pose through the maps' own uncertainty alone."""
    T, rng = pose.T_base_target, np.random.default_rng(seed)
    forward, backward = look_up(base, target, T, pose.sensor, some_rows(base, target, config, rng))
    information = information_of(pose.blocks) + pose.known_before
    # The base's field enters the residual with a minus, the target's with a plus.
    of_base = [-rotate_vectors(error, T.inv()) for error in _errors(base, transform_points(forward.positions, T))]
    of_target = _errors(target, backward.positions)
    # The maps' errors are independent, so their squares are added, rather than one draw of each.
    total: Covariance6 = np.zeros((6, 6))
    for lookup, noise_sd, errors in ((forward, target.noise_sd, of_base), (backward, base.noise_sd, of_target)):
        if errors:
            moves = np.linalg.solve(information, _scores(lookup, noise_sd, pose, errors).T)[:6]
            total = total + moves @ moves.T / len(errors)
    return total


def _errors(of: PreparedMap, points: Points) -> list[Vectors]:
    """How a map's field may differ from its mean at points: draws; none without points."""
    if not len(points):
        return []
    posterior = of.field_map.posterior
    mean = posterior.evaluate(points).field
    return [posterior.evaluate(points, 0, weights).field - mean for weights in of.draws()]


def _scores(lookup: Lookup, noise_sd: float, pose: RefinedPose, errors: list[Vectors]) -> Matrix:
    """Gradient of the likelihood that each draw adds: (draws, 6 + k)."""
    residual2 = np.einsum("ni,ni->n", lookup.residual, lookup.residual)
    weight, _ = student_weights(residual2, lookup.sd, noise_sd)
    JW = residual_jacobian(lookup, pose.center, pose.sensor) * weight[:, None, None]
    return np.stack([np.einsum("nij,ni->j", JW, error) for error in errors])
