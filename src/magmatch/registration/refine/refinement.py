# SPDX-License-Identifier: BSD-3-Clause
"""Dense refinement of one pose against the field itself, symmetric in the two maps.

Residuals are taken in target axes, ``r = b - R^T B_base(T y)`` at the target's samples y and
``r = B_target(T^-1 x) - R^T b`` at the base's samples x. With the pose perturbed about a centre c of the target,
``T Exp(xi)``, both have the same Jacobian, ``-[b]x theta + G ([y - c]x theta - rho)``, G the gradient of the map
that is looked up, in target axes. Bias and scale of the target's magnetometer are further columns (`sensors.py`).
Residuals are taken half-way between the two gains: with the base's gain, a target scaled down would always fit
better, and base and target could not be swapped.
"""

from dataclasses import dataclass, replace

import numpy as np
from pydantic import Field
from scipy.linalg import block_diag
from scipy.spatial.transform import RigidTransform

from magmatch.data.checks import MIN_SAMPLES
from magmatch.estimation.candidate_poses import pose_inaccuracy
from magmatch.estimation.cubes import sum_by_cube
from magmatch.estimation.gauss_newton import STUDENT_DOF, is_close, shortened, student_weights
from magmatch.estimation.limits import MOST_POINTS, MOST_STEPS
from magmatch.estimation.model_prior import SENSORS_DIFFER
from magmatch.estimation.pose_prior import FAR2, PosePrior
from magmatch.field.values import gradient_of
from magmatch.geometry import perturbation, perturbation_between, rotate_vectors, skew, transform_points
from magmatch.registration.prepared.drift import field_variance
from magmatch.registration.prepared.prepared_map import MEDIAN_CHI2_3, PreparedMap, common_length
from magmatch.registration.refine.sensors import (
    SensorConfig,
    SensorMode,
    SensorModel,
    identical_sensors,
    levels_to_try,
    prior_sd,
)
from magmatch.settings import Settings
from magmatch.typing import Indices, Matrix, Points, Scalars, Tensors, Vector3, Vectors


class RefinementConfig(Settings):
    """Settings of the dense refinement."""

    # What may differ between the two magnetometers.
    sensor: SensorConfig = Field(default_factory=SensorConfig)


@dataclass(frozen=True, eq=False, slots=True)
class ResidualBlock:
    """One direction of comparison at the optimum: a map looked up at the other survey's samples."""

    information: Matrix  # (6 + k, 6 + k): weighted ``J^T J`` of the pose and the k sensor parameters
    # (6 + k, 6 + k): of the log-likelihood, which is less than the weighted information if residuals are large; the
    # scatter of an estimate follows from it
    curvature: Matrix
    scores: Matrix  # (n, 6 + k): each sample's weighted gradient
    positions: Points  # (n, 3), m: where the samples lie, target's model frame
    residual2: Scalars  # (n,): squared norm of each residual over its expected variance
    drift: Matrix  # (6 + k, 6 + k): covariance of the gradients' sum due to the drift of the samples' own poses


@dataclass(frozen=True, eq=False, slots=True)
class RefinedPose:
    """A pose at the optimum of the field residual, in model frames."""

    T_base_target: RigidTransform  # model frame to model frame
    center: Vector3  # (3,), m: point of the target about which the perturbation is taken, target's model frame
    sensor: SensorModel  # bias and gain of the target's magnetometer against the base's, target's model axes
    sensor_sd: np.ndarray  # (k,): prior standard deviations that the sensor's parameters were given
    prior_information: Matrix  # (6, 6): information of the pose prior, about the centre
    blocks: tuple[ResidualBlock, ...]  # one for each direction of comparison; empty if the maps hardly overlap
    log_prior: float = 0.0  # nats: of this sensor model, beside the others

    @property
    def known_before(self) -> Matrix:
        """Information on pose and sensor together that does not come from the samples: (6 + k, 6 + k)."""
        known: Matrix = block_diag(self.prior_information, np.diag(self.sensor_sd**-2))
        return known

    def stepped(self, xi: np.ndarray) -> "RefinedPose":
        """Give the pose after a step of it, about the centre, and of the sensor; none is stated of the new pose.

        No parameter of the sensor leaves what its prior admits.
        """
        return replace(
            self,
            T_base_target=self.T_base_target * perturbation(xi[:6], self.center),
            sensor=self.sensor.stepped(xi[6:], np.sqrt(FAR2) * self.sensor_sd),
        )


def refine(
    base: PreparedMap,
    target: PreparedMap,
    start: "RigidTransform | RefinedPose",
    prior: PosePrior,
    sensors: SensorMode,
    rng: np.random.Generator,
    level: int = 0,
    n_samples: int = MOST_POINTS,
) -> RefinedPose:
    """Minimise the field residuals of both directions, with Student-t likelihood, by Newton's steps.

    A start that was refined keeps its own sensor model and level; ``level`` says how far the two magnetometers may
    differ, see `prior_sd`; ``rng`` picks the samples if a survey has more than ``n_samples``.
    """
    rows = some_rows(base, target, n_samples, rng)
    lengthscale, center = common_length(base, target), target.samples.mean(axis=0)
    pose = (
        replace(start, center=center)
        if isinstance(start, RefinedPose)
        else _at(start, center, sensors, level, prior.up_target)
    )
    scale = np.concatenate([np.repeat(pose_inaccuracy(lengthscale), 3), pose.sensor_sd])
    for _ in range(MOST_STEPS):
        blocks = compare(base, target, pose, rows)
        if not blocks:
            break
        v = -np.sum([d.scores.sum(axis=0) for d in blocks], axis=0)
        # The likelihood's curvature: with the weighted information in its place, steps would be too short by a third.
        A = np.sum([d.curvature for d in blocks], axis=0)
        # Neighbouring residuals are not independent; unscaled they would override any prior.
        excess = overdispersion(blocks, 2 * lengthscale)
        A, v = A / excess, v / excess
        known, slope, _ = prior.rows(pose.T_base_target, center)
        A[:6, :6] += known
        v[:6] -= slope
        A[6:, 6:] += np.diag(pose.sensor_sd**-2)
        v[6:] -= pose.sensor.parameters / pose.sensor_sd**2
        # Of least norm, so that a direction that the data do not determine does not change.
        xi = scale * np.linalg.lstsq(A * np.outer(scale, scale), v * scale, rcond=1e-10)[0]
        xi = shortened(xi, scale[:6])
        pose = pose.stepped(xi)
        if is_close(xi, A):
            break
    known = prior.rows(pose.T_base_target, center)[0]
    return replace(pose, prior_information=known, blocks=compare(base, target, pose, rows))


def _at(
    T_base_target: RigidTransform, center: Vector3, mode: SensorMode, level: int, up: Vector3 | None
) -> RefinedPose:
    """Give a pose before any refinement, with the sensors alike."""
    sensor = identical_sensors(mode, level)
    sd = prior_sd(level, sensor.n_parameters, up)
    log_prior = SENSORS_DIFFER * levels_to_try(mode).index(level)
    return RefinedPose(T_base_target, center, sensor, sd, np.zeros((6, 6)), (), log_prior)


def step_between(before: RefinedPose, after: RefinedPose) -> np.ndarray:
    """Perturbation about the centre that takes one pose to the other."""
    return perturbation_between(before.T_base_target, after.T_base_target, before.center)


def information_of(blocks: tuple[ResidualBlock, ...]) -> Matrix:
    """Information of both directions together: (6 + k, 6 + k)."""
    A: Matrix = np.sum([d.information for d in blocks], axis=0)
    return A


def overdispersion(blocks: tuple[ResidualBlock, ...], side: float) -> float:
    """Variance of cell-wise sums of the gradient relative to that of independent samples (at least 1)."""
    A = information_of(blocks)
    clusters = np.concatenate([sum_by_cube(d.scores, d.positions, side) for d in blocks])
    meat = clusters.T @ clusters
    ratio = np.trace(np.linalg.lstsq(A, meat, rcond=1e-10)[0]) / len(A)
    return max(1.0, float(ratio))


def compare(
    base: PreparedMap, target: PreparedMap, pose: RefinedPose, rows: tuple[Indices, Indices]
) -> tuple[ResidualBlock, ...]:
    """Residuals, weights and Jacobians at a pose, of the directions with enough samples inside the other map."""
    forward, backward = look_up(base, target, pose, rows)
    sides = (forward, target), (backward, base)
    return tuple(_residual_block(side, of, pose) for side, of in sides if len(side.sd) >= MIN_SAMPLES)


def look_up(
    base: PreparedMap, target: PreparedMap, pose: RefinedPose, rows: tuple[Indices, Indices]
) -> "tuple[Lookup, Lookup]":
    """The base's map at the target's samples, and the target's map at the base's samples."""
    T_base_target, T_target_base, sensor = pose.T_base_target, pose.T_base_target.inv(), pose.sensor
    position_variance = base.drift.sd**2 + target.drift.sd**2
    y, b = target.samples[rows[0]], target.sample_field[rows[0]]
    _, sd, _, is_known = base.raster.lookup(transform_points(y, T_base_target))
    y, corrected = y[is_known], sensor.correct(b[is_known])
    seen = base.posterior.evaluate(transform_points(y, T_base_target), order=1).rotated(T_target_base)
    G = gradient_of(seen)
    sd = np.sqrt(sd[is_known] ** 2 + field_variance(G, position_variance))
    forward = Lookup(rows[0][is_known], y, seen.field, sensor.half_way(corrected - seen.field), G, corrected, sd)

    z = transform_points(base.samples[rows[1]], T_target_base)
    b = rotate_vectors(base.sample_field[rows[1]], T_target_base)
    _, sd, _, is_known = target.raster.lookup(z)
    z, b = z[is_known], b[is_known]
    seen = target.posterior.evaluate(z, order=1)
    corrected, G = sensor.correct(seen.field), gradient_of(seen)
    sd = np.sqrt(sd[is_known] ** 2 + field_variance(G, position_variance))
    return forward, Lookup(rows[1][is_known], z, b, sensor.half_way(corrected - b), G, corrected, sd)


@dataclass(frozen=True, eq=False, slots=True)
class Lookup:
    """One survey's samples against the other's map, all in target axes."""

    rows: Indices  # of the survey's samples
    positions: Points
    base_side: Vectors  # turns with the pose
    residual: Vectors
    gradient: Tensors  # of the map that was looked up
    target_side: Vectors  # corrected by the sensor model
    sd: Scalars  # of the map that was looked up, and of positions that are off


def residual_jacobian(lookup: Lookup, pose: RefinedPose) -> np.ndarray:
    """Change of the residuals with pose and sensor: (n, 3, 6 + k), see the module's equation."""
    lever, G = skew(lookup.positions - pose.center), lookup.gradient
    by_sensor = pose.sensor.jacobian((lookup.target_side + lookup.base_side) / 2)
    return np.concatenate([G @ lever - skew(lookup.base_side), -G, by_sensor], axis=2)


def residual_weights(residual2: Scalars, map_sd: Scalars, noise_sd: float) -> tuple[Scalars, Scalars]:
    """Weight of each residual (1/T^2), and the ratio of its curvature of the likelihood to that weight.

    The weight falls as its residual grows, in one direction of three: the ratio is between 1/3 and 1.
    """
    # Variance of the residuals beyond the map's own spread, never less than the noise.
    map_variance = map_sd**2
    excess = max(float(np.median(residual2)) / MEDIAN_CHI2_3 - float(np.median(map_variance)), noise_sd**2)
    variance = excess + map_variance
    chi2 = residual2 / variance
    return student_weights(chi2, 3) / variance, 1 - 2 / 3 * chi2 / (STUDENT_DOF + chi2)


def _residual_block(lookup: Lookup, of: PreparedMap, pose: RefinedPose) -> ResidualBlock:
    J = residual_jacobian(lookup, pose)
    r2 = np.einsum("ni,ni->n", lookup.residual, lookup.residual)
    weight, bend = residual_weights(r2, lookup.sd, of.noise_sd)
    rows = J.reshape(-1, J.shape[2])
    weighted = rows * np.repeat(weight, 3)[:, None]
    return ResidualBlock(
        information=weighted.T @ rows,
        curvature=(weighted * np.repeat(bend, 3)[:, None]).T @ rows,
        scores=(weighted * lookup.residual.reshape(-1, 1)).reshape(J.shape).sum(axis=1),
        positions=lookup.positions,
        residual2=r2 / (of.noise_sd**2 + lookup.sd**2),
        drift=of.drift.score_covariance(weighted.reshape(J.shape), lookup.gradient, lookup.rows),
    )


def some_rows(
    base: PreparedMap, target: PreparedMap, n_samples: int, rng: np.random.Generator
) -> tuple[Indices, Indices]:
    """Samples of the target and of the base that are compared."""
    some = (np.sort(rng.permutation(len(m.samples))[:n_samples]) for m in (target, base))
    of_target, of_base = (rows.astype(np.int64) for rows in some)
    return of_target, of_base
