# SPDX-License-Identifier: BSD-3-Clause
"""Covariance of the refined pose: a cluster-robust sandwich estimator over independent cells; and of the maps.

Along a path beside another, the error of a map between its samples is nearly constant, so the pose follows it and no
residual shows it. Draws from the maps' posteriors show it: each shifts the pose by one linear step.
"""

import numpy as np

from magmatch.estimation.cubes import sum_by_cube
from magmatch.estimation.limits import MOST_POINTS
from magmatch.geometry import ROUNDING, rotate_vectors, transform_points
from magmatch.registration.prepared.prepared_map import PreparedMap
from magmatch.registration.refine.refinement import (
    Lookup,
    RefinedPose,
    information_of,
    look_up,
    residual_jacobian,
    residual_weights,
    some_rows,
)
from magmatch.typing import Covariance6, Matrix, Points, Vectors


def joint_covariance(pose: RefinedPose, cell_side: float) -> Matrix | None:
    """Covariance of the perturbation about the pose's centre and of the sensor's parameters.

    Map errors are shared by neighbouring residuals, so each direction of comparison is a cluster sandwich
    ``A^-1 (sum g g^T) A^-1``, A the curvature of its log-likelihood, with g summed over cells; the directions share
    noise (one survey's samples made the map that the other is compared with), so their covariances are added rather
    than their information.
    """
    prior = pose.known_before
    total = np.zeros_like(prior)
    n_used = 0
    for block in pose.blocks:
        clusters = sum_by_cube(block.scores, block.positions, cell_side)
        n_cells = len(clusters)
        curvature = block.curvature + prior
        # Each cell is worth three numbers: six are fitted, and their mean is taken out.
        n_free = n_cells - 6 / 3 - 1
        if n_free <= 0 or np.linalg.cond(_balanced(curvature[:6, :6])[0]) > 1 / ROUNDING:
            continue
        clusters = clusters - clusters.mean(axis=0)
        meat = clusters.T @ clusters * n_cells / n_free
        bread = np.linalg.inv(_regular(curvature))
        total += bread @ (meat + prior) @ bread
        n_used += 1
    return (total + total.T) / 2 if n_used else None


def enclosing(covariance: Covariance6, other: Covariance6) -> Covariance6:
    """Smallest covariance not below either of two, along the axes in which both are diagonal."""
    floor = np.maximum(ROUNDING * np.diag(other), np.finfo(float).tiny)
    scale = np.sqrt(np.maximum(np.diag(covariance), floor))
    spread, along = np.linalg.eigh(covariance / np.outer(scale, scale))
    root = scale[:, None] * along * np.sqrt(np.maximum(spread, ROUNDING))
    relative = np.linalg.solve(root, np.linalg.solve(root, other).T)
    values, vectors = np.linalg.eigh((relative + relative.T) / 2)
    if values.max() <= 1:
        return covariance
    axes = root @ vectors
    return np.asarray((axes * np.maximum(values, 1)) @ axes.T)


def drift_covariance(pose: RefinedPose) -> Covariance6:
    """Covariance of a pose due to the drift that each survey states for its own positions."""
    total = np.zeros_like(pose.known_before)
    for block in pose.blocks:
        # An error bends both, a sample's pull and what holds against it: weights answer weights.
        # Balanced: beside what a tied sensor is known by, the pose's information would seem rounding.
        balanced, scales = _balanced(_regular(block.information + pose.known_before))
        bread = np.linalg.pinv(balanced, hermitian=True) / scales
        total += bread @ block.drift @ bread
    covariance: Covariance6 = ((total + total.T) / 2)[:6, :6]
    return covariance


def map_covariance(base: PreparedMap, target: PreparedMap, pose: RefinedPose, seed: int) -> Covariance6:
    """Covariance of a pose through the maps' own uncertainty alone."""
    T, rows = pose.T_base_target, some_rows(base, target, MOST_POINTS, np.random.default_rng(seed))
    forward, backward = look_up(base, target, pose, rows)
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
    weight, _ = residual_weights(residual2, lookup.sd, noise_sd)
    JW = residual_jacobian(lookup, pose) * weight[:, None, None]
    return np.stack([np.einsum("nij,ni->j", JW, error) for error in errors])


def _regular(A: Matrix) -> Matrix:
    """Guard of the inverse: far below any information that matters."""
    guarded: Matrix = A + np.diag(ROUNDING * np.diag(A))
    return guarded


def _balanced(A: Matrix) -> tuple[Matrix, Matrix]:
    """A matrix with a diagonal of ones, and what it was divided by."""
    d = np.sqrt(np.maximum(np.diag(A), np.finfo(float).tiny))
    return A / np.outer(d, d), np.outer(d, d)
