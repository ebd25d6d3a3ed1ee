# SPDX-License-Identifier: BSD-3-Clause
"""How far the refined pose may be off: a sandwich over independent cells, and the directions left free."""

import numpy as np
from scipy.spatial.transform import RigidTransform

from magmatch.geometry import rotation_matrix, skew
from magmatch.registration.prepared.cubes import sum_by_cube
from magmatch.registration.refine.refinement import RefinedPose
from magmatch.registration.result import DegenerateDirection
from magmatch.typing import Covariance6, Matrix

# Fewer independent cells than this give no covariance.
MIN_CELLS = 4
# Relative variance below which a direction counts as known to rounding.
SMALLEST_SPREAD = 1e-12


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
        if n_cells < MIN_CELLS or np.linalg.cond(_balanced(curvature[:6, :6])) > 1e12:
            continue
        clusters = clusters - clusters.mean(axis=0)
        # Six fitted parameters use up part of the clusters' spread.
        meat = clusters.T @ clusters * n_cells / max(n_cells - 3.0, 1.0)
        bread = np.linalg.inv(_regular(curvature))
        total += bread @ (meat + prior) @ bread
        n_used += 1
    return (total + total.T) / 2 if n_used else None


def enclosing(covariance: Covariance6, other: Covariance6) -> Covariance6:
    """Least covariance that is nowhere below either of two, along the axes in which both are diagonal."""
    floor = np.maximum(SMALLEST_SPREAD * np.diag(other), np.finfo(float).tiny)
    scale = np.sqrt(np.maximum(np.diag(covariance), floor))
    spread, along = np.linalg.eigh(covariance / np.outer(scale, scale))
    root = scale[:, None] * along * np.sqrt(np.maximum(spread, SMALLEST_SPREAD))
    relative = np.linalg.solve(root, np.linalg.solve(root, other).T)
    values, vectors = np.linalg.eigh((relative + relative.T) / 2)
    if values.max() <= 1:
        return covariance
    axes = root @ vectors
    return np.asarray((axes * np.maximum(values, 1)) @ axes.T)


def drift_covariance(pose: RefinedPose) -> Covariance6:
    """Covariance of a pose that follows the drift which each survey states of its own positions."""
    total = np.zeros_like(pose.known_before)
    for block in pose.blocks:
        # An error bends both, a sample's pull and what holds against it: weights answer weights.
        bread = np.linalg.pinv(_regular(block.information + pose.known_before), hermitian=True)
        total += bread @ block.drift @ bread
    covariance: Covariance6 = ((total + total.T) / 2)[:6, :6]
    return covariance


def to_survey_axes(covariance: Covariance6, center_model: np.ndarray, T_survey_model: RigidTransform) -> Covariance6:
    """Covariance of xi in ``T_true = T_estimate Exp(xi)``, target's survey frame."""
    R = rotation_matrix(T_survey_model)
    center = T_survey_model.apply(center_model)
    M = np.zeros((6, 6))
    M[:3, :3] = M[3:, 3:] = R
    # Turning about the origin instead of the centre moves the centre: rho = R rho_c - theta x c.
    M[3:, :3] = skew(center[None])[0] @ R
    moved = M @ covariance @ M.T
    symmetric: Covariance6 = (moved + moved.T) / 2
    return symmetric


def free_directions(
    covariance: Covariance6,
    center_model: np.ndarray,
    T_survey_model: RigidTransform,
    R_base_target: Matrix,
    max_sd_rotation: float,
    max_sd_translation: float,
) -> tuple[DegenerateDirection, ...]:
    """Directions in which the pose is worse known than allowed, with words in base axes.

    Returns
    -------
    tuple of DegenerateDirection
    """
    scale = np.array(3 * [max_sd_rotation] + 3 * [max_sd_translation])
    power, vectors = np.linalg.eigh(covariance / np.outer(scale, scale))
    R = rotation_matrix(T_survey_model)
    center = T_survey_model.apply(center_model)
    found = []
    for k in np.flatnonzero(power > 1.0)[::-1]:
        local = vectors[:, k] * scale
        theta, rho = R @ local[:3], R @ local[3:]
        xi = np.concatenate([theta, rho - np.cross(theta, center)])
        is_turn = np.linalg.norm(vectors[:3, k]) > np.linalg.norm(vectors[3:, k])
        words = (
            ("turning about" if is_turn else "sliding along")
            + " base "
            + _axis_words(R_base_target @ (theta if is_turn else rho))
        )
        found.append(DegenerateDirection(xi / np.linalg.norm(xi), words))
    return tuple(found)


def _axis_words(v: np.ndarray) -> str:
    v = v / np.linalg.norm(v)
    k = int(np.argmax(np.abs(v)))
    if abs(v[k]) > 0.9:
        return "xyz"[k]
    return "direction ({:+.2f}, {:+.2f}, {:+.2f})".format(*(v * np.sign(v[k])))


def _regular(A: Matrix) -> Matrix:
    """Guard of the inverse: far below any information that matters."""
    guarded: Matrix = A + np.diag(1e-12 * np.diag(A))
    return guarded


def _balanced(A: Matrix) -> Matrix:
    d = np.sqrt(np.maximum(np.diag(A), np.finfo(float).tiny))
    balanced: Matrix = A / np.outer(d, d)
    return balanced
