# SPDX-License-Identifier: BSD-3-Clause
"""Dense refinement of one pose against the field itself, symmetric in the two maps.

Residuals are taken in target axes, ``r = b - R^T B_base(T y)`` at the target's samples y and
``r = B_target(T^-1 x) - R^T b`` at the base's samples x. With the pose perturbed about a centre c of the target,
``T Exp(xi)``, both have the same Jacobian, ``-[b]x theta + G ([y - c]x theta - rho)``, G the gradient of the map
that is looked up, in target axes.
"""

from dataclasses import dataclass

import numpy as np
from pydantic import BaseModel, ConfigDict, Field
from scipy.spatial.transform import RigidTransform, Rotation

from magmatch.geometry import rotate_vectors, skew, transform_points
from magmatch.registration.prepared import PreparedMap
from magmatch.registration.scoring import MEDIAN_CHI2_3
from magmatch.typing import Indices, Matrix, Points, Scalars, Vector3, Vectors

# Fewer samples than this in one direction say too little to be used.
MIN_SAMPLES = 20
# Degrees of freedom of the Student-t residual model: outliers lose weight, inliers keep it.
STUDENT_DOF = 4.0


class RefinementConfig(BaseModel):
    """Settings of the dense refinement."""

    model_config = ConfigDict(frozen=True, extra="forbid")

    # Off in preset 'paper': the published method ends with consensus.
    is_enabled: bool = True
    # Samples per survey; more than enough for the data's floor.
    n_samples: int = Field(default=1200, ge=MIN_SAMPLES)
    # Most Gauss-Newton steps.
    n_steps: int = Field(default=12, ge=1)
    # Best candidates to refine and compare.
    n_candidates: int = Field(default=4, ge=1)


@dataclass(frozen=True, eq=False, slots=True)
class Direction:
    """One direction of comparison at the optimum: a map looked up at the other survey's samples.

    Attributes
    ----------
    information : (6, 6) array
        Weighted ``J^T J``.
    scores : (n, 6) array
        Each sample's weighted gradient.
    positions : (n, 3) array, m
        Where the samples lie, target's model frame.
    residual2 : (n,) array
        Squared norm of each residual over its expected variance.
    """

    information: Matrix
    scores: Matrix
    positions: Points
    residual2: Scalars


@dataclass(frozen=True, eq=False, slots=True)
class RefinedPose:
    """A pose at the optimum of the field residual, in model frames.

    Attributes
    ----------
    T_base_target : RigidTransform
        Model frame to model frame.
    center : (3,) array, m
        Point of the target about which the perturbation is taken, target's model frame.
    directions : tuple of Direction
        What each direction of comparison says; empty where the maps hardly overlap.
    """

    T_base_target: RigidTransform
    center: Vector3
    directions: tuple[Direction, ...]


def refine(
    base: PreparedMap,
    target: PreparedMap,
    T_base_target: RigidTransform,
    config: RefinementConfig,
    rng: np.random.Generator,
) -> RefinedPose:
    """Minimise the field residual of both directions by Gauss-Newton with Student-t weights.

    Parameters
    ----------
    base, target : PreparedMap
    T_base_target : RigidTransform
        Start, model frame to model frame.
    config : RefinementConfig
    rng : numpy Generator
        Picks the samples where there are more than needed.

    Returns
    -------
    RefinedPose
    """
    target_rows = _some_rows(len(target.samples), config.n_samples, rng)
    base_rows = _some_rows(len(base.samples), config.n_samples, rng)
    T, center = T_base_target, target.samples.mean(axis=0)
    lengthscale = min(base.lengthscale, target.lengthscale)
    limit = np.array([0.1, 0.1, 0.1, *(3 * [0.3 * lengthscale])])
    for _ in range(config.n_steps):
        directions = compare(base, target, T, center, target_rows, base_rows)
        if not directions:
            break
        A = sum((d.information for d in directions), np.zeros((6, 6)))
        v = -sum((d.scores.sum(axis=0) for d in directions), np.zeros(6))
        # Minimum-norm step: a direction that the data do not fix is left where the search put it.
        xi = np.linalg.lstsq(A, v, rcond=1e-10)[0]
        xi /= max(1.0, float(np.abs(xi / limit).max()))
        T = T * perturbation(xi, center)
        if np.linalg.norm(xi[:3]) < 1e-8 and np.linalg.norm(xi[3:]) < 1e-8:
            break
    return RefinedPose(T, center, compare(base, target, T, center, target_rows, base_rows))


def perturbation(xi: np.ndarray, center: Vector3) -> RigidTransform:
    """Small motion about a centre: turn by ``xi[:3]`` (rad) about it, then shift by ``xi[3:]`` (m)."""
    rotation = Rotation.from_rotvec(xi[:3])
    return RigidTransform.from_components(center + xi[3:] - rotation.apply(center), rotation)


def compare(
    base: PreparedMap,
    target: PreparedMap,
    T_base_target: RigidTransform,
    center: Vector3,
    target_rows: Indices,
    base_rows: Indices,
) -> tuple[Direction, ...]:
    """Residuals, weights and Jacobians of both directions at a pose.

    Returns
    -------
    tuple of Direction
        Directions with at least `MIN_SAMPLES` samples inside the other map.
    """
    T_target_base = T_base_target.inv()
    found = []
    y, b = target.samples[target_rows], target.sample_field[target_rows]
    _, sd, _, is_known = base.raster.lookup(transform_points(y, T_base_target))
    if is_known.sum() >= MIN_SAMPLES:
        y, b, sd = y[is_known], b[is_known], sd[is_known]
        values = base.field_map.posterior.evaluate(transform_points(y, T_base_target), order=1)
        looked_up = values.rotated(T_target_base)
        assert looked_up.gradient is not None
        found.append(_direction(y, b, b - looked_up.field, looked_up.gradient, sd, target.noise_sd, center))
    x, b = base.samples[base_rows], base.sample_field[base_rows]
    z, b = transform_points(x, T_target_base), rotate_vectors(b, T_target_base)
    _, sd, _, is_known = target.raster.lookup(z)
    if is_known.sum() >= MIN_SAMPLES:
        z, b, sd = z[is_known], b[is_known], sd[is_known]
        values = target.field_map.posterior.evaluate(z, order=1)
        assert values.gradient is not None
        found.append(_direction(z, b, values.field - b, values.gradient, sd, base.noise_sd, center))
    return tuple(found)


def _direction(
    y: Points, b: Vectors, residual: Vectors, gradient: np.ndarray, sd: Scalars, noise_sd: float, center: Vector3
) -> Direction:
    lever = skew(y - center)
    J = np.concatenate([gradient @ lever - skew(b), -gradient], axis=2)
    r2 = np.einsum("ni,ni->n", residual, residual)
    # What the residuals themselves show beyond the map's own spread, never less than a share of the noise.
    excess = max(float(np.median(r2)) / MEDIAN_CHI2_3 - float(np.median(sd**2)), 0.25 * noise_sd**2)
    variance = excess + sd**2
    weight = (STUDENT_DOF + 3) / (STUDENT_DOF + r2 / variance) / variance
    JW = J * weight[:, None, None]
    return Direction(
        information=np.einsum("nij,nik->jk", JW, J),
        scores=np.einsum("nij,ni->nj", JW, residual),
        positions=y,
        residual2=r2 / (noise_sd**2 + sd**2),
    )


def _some_rows(n: int, limit: int, rng: np.random.Generator) -> Indices:
    return np.sort(rng.permutation(n)[:limit]).astype(np.int64)
