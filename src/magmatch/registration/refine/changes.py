# SPDX-License-Identifier: BSD-3-Clause
"""Joint estimation of a pose and a change of the field: iron that was moved between two surveys.

The change due to a moved source is itself a field without sources in the surveyed region, strongest near the source's
old and new positions, so a few charges on a layer around the samples describe it. Each charge has its own
maximum-likelihood prior variance, which is nearly zero for most (sparse Bayesian learning, Tipping 2001).
"""

from dataclasses import dataclass, replace

import numpy as np
from scipy.linalg import block_diag
from scipy.spatial.transform import RigidTransform

from magmatch.data.checks import MIN_SAMPLES
from magmatch.estimation.candidate_poses import pose_inaccuracy
from magmatch.estimation.gauss_newton import is_close, shortened
from magmatch.estimation.limits import CHANGE_SAMPLES, MOST_STEPS, N_CHARGES, N_STRENGTHS
from magmatch.estimation.pose_prior import PosePrior
from magmatch.field.equivalent_sources.shell import SourceShell, lay_shell
from magmatch.field.spline.spline_prior import CONSTANT_SD
from magmatch.field.values import gradient_of
from magmatch.geometry import transform_points
from magmatch.registration.prepared.drift import Drift
from magmatch.registration.prepared.prepared_map import MEDIAN_CHI2_3, PreparedMap, common_length
from magmatch.registration.refine.refinement import Lookup, RefinedPose, ResidualBlock, residual_jacobian
from magmatch.typing import Indices, Mask, Matrix, Points, Scalars, Vectors

# Distance of the charges from the samples, in correlation lengths.
DISTANCE = 0.6
# Charges whose prior variance has fallen below this share of the strongest one's are left out from then on.
FADED = 1e-5
# Factor on the pose's covariance because the same data selected the remaining charges (measured).
SELECTION_INFLATION = 16.0
# Misfit of the best pose's cells above which something may have moved: right poses without changes stay below it.
MAX_MISFIT = 2.0
EPS = float(np.finfo(float).eps)


@dataclass(frozen=True, eq=False, slots=True)
class ChangedPose:
    """A pose with the change of the field that was estimated beside it."""

    pose: RefinedPose
    log_ratio: float  # nats: log-likelihood ratio of the base's field with this change to an independent sparse field
    noise: float  # variance of the residuals, in units of that stated by noise and the base's spread; at least 1
    shell: SourceShell
    weights: np.ndarray  # (m,): charges that describe the change

    def change_at(self, points: Points) -> Vectors:
        """The target's field minus the base's, target's model frame."""
        return self.shell.evaluate(points, self.weights, 0, np.zeros(3)).field


@dataclass(frozen=True, eq=False, slots=True)
class _Samples:
    """The target's samples that are compared, and the field of unit charges there."""

    rows: Indices  # (n,) ints: of the target's samples
    positions: Points  # (n, 3), m: target's model frame
    field: Vectors  # (n, 3), T: in its axes
    map_sd: Scalars  # (n,), T: the base's spread there
    shell: SourceShell
    charges: Matrix  # (3 n, m), T
    weight: Scalars  # (3 n,), 1/T^2: inverse of the variance stated by noise and the base's spread


@dataclass(frozen=True, eq=False, slots=True)
class _Estimate:
    """Result of one linear step: steps of pose and sensor, then charges."""

    charges: Indices  # (m,) ints: the remaining ones; the variance of the others has vanished
    values: np.ndarray  # (k + m,)
    covariance: Matrix  # (k + m, k + m)
    strengths: Scalars  # (m,): prior variance of each charge, updated by this step
    noise: float  # variance of the remaining residuals, in units of the stated variance; at least 1


def refine_beside_changes(
    base: PreparedMap,
    target: PreparedMap,
    pose: RefinedPose,
    agrees: Mask,
    prior: PosePrior,
    rng: np.random.Generator,
) -> ChangedPose | None:
    """Refine a pose together with a sparse field of moved sources, by Gauss-Newton; None where nothing tells it."""
    samples = _choose_samples(base, target, pose.T_base_target, agrees, rng)
    if samples is None:
        return None
    try:
        return _refine(base, target, pose, samples, prior)
    except np.linalg.LinAlgError:  # steps led to where nothing tells of the pose, as out of the base
        return None


def _refine(
    base: PreparedMap, target: PreparedMap, pose: RefinedPose, samples: _Samples, prior: PosePrior
) -> ChangedPose:
    longest = np.repeat(pose_inaccuracy(common_length(base, target)), 3)
    gram = samples.charges.T @ (samples.weight[:, None] * samples.charges)
    pose = replace(pose, sensor=pose.sensor.stepped(-pose.sensor.parameters))
    k = 6 + len(pose.sensor_sd)
    lookup = _look_up(base, samples, pose)
    estimate = _solve(lookup, samples, gram, pose, prior, MAX_MISFIT**2)
    for _ in range(MOST_STEPS):
        xi = shortened(estimate.values[:k], longest)
        pose, is_last = pose.stepped(xi), is_close(xi, np.linalg.inv(estimate.covariance[:k, :k]))
        lookup = _look_up(base, samples, pose)
        estimate = _solve(lookup, samples, gram, pose, prior, estimate.noise, estimate)
        if is_last:
            break
    block = _residual_block(lookup, samples, gram, pose, estimate, target.drift)
    known = prior.rows(pose.T_base_target, pose.center)[0]
    refined = replace(pose, prior_information=known, blocks=(block,))
    weights = np.zeros(len(gram))
    weights[estimate.charges] = estimate.values[k:]
    log_ratio = _log_ratio(lookup, samples, gram, estimate)
    return ChangedPose(refined, log_ratio, estimate.noise, samples.shell, weights)


def _choose_samples(
    base: PreparedMap,
    target: PreparedMap,
    T_base_target: RigidTransform,
    agrees: Mask,
    rng: np.random.Generator,
) -> _Samples | None:
    _, map_sd, _, is_known = base.raster.lookup(transform_points(target.samples, T_base_target))
    rows = np.sort(rng.permutation(np.flatnonzero(agrees & is_known))[:CHANGE_SAMPLES])
    if len(rows) < MIN_SAMPLES:
        return None
    y, map_sd = target.samples[rows], map_sd[rows]
    weight = np.repeat(1 / (target.noise_sd**2 + map_sd**2), 3)
    distance = DISTANCE * common_length(base, target)
    shell = lay_shell(y, distance, distance / 2, N_CHARGES)
    # From component-major rows to a row per sample and component.
    charges = np.moveaxis(shell.design(y).reshape(3, len(y), -1), 0, 1).reshape(3 * len(y), -1)
    return _Samples(rows, y, target.sample_field[rows], map_sd, shell, np.ascontiguousarray(charges), weight)


def _look_up(base: PreparedMap, samples: _Samples, pose: RefinedPose) -> Lookup:
    T = pose.T_base_target
    seen = base.posterior.evaluate(transform_points(samples.positions, T), order=1).rotated(T.inv())
    corrected = pose.sensor.correct(samples.field)
    residual = corrected - seen.field
    return Lookup(samples.rows, samples.positions, seen.field, residual, gradient_of(seen), corrected, samples.map_sd)


def _solve(
    lookup: Lookup,
    samples: _Samples,
    gram: Matrix,
    pose: RefinedPose,
    prior: PosePrior,
    noise: float,
    last: _Estimate | None = None,
) -> _Estimate:
    """Solve for a step of pose and sensor together with the charges, and update their strengths and the noise."""
    k, r = 6 + len(pose.sensor_sd), lookup.residual.ravel()
    start = max(float(np.median((lookup.residual**2).sum(axis=1))) / MEDIAN_CHI2_3, 1 / samples.weight.max())
    left, strengths = np.arange(len(gram)), np.full(len(gram), start)
    if last:
        lasting = last.strengths > FADED * last.strengths.max(initial=0.0)
        left, strengths = last.charges[lasting], last.strengths[lasting]
    charges, J = samples.charges[:, left], residual_jacobian(lookup, pose).reshape(len(r), k)
    WJ, Wr = samples.weight[:, None] * J, samples.weight * r
    cross = -WJ.T @ charges
    A = np.block([[WJ.T @ J, cross], [cross.T, gram[np.ix_(left, left)]]])
    v = np.concatenate([-J.T @ Wr, charges.T @ Wr])
    known, slope, _ = prior.rows(pose.T_base_target, pose.center)
    before, pull = block_diag(known, np.diag(pose.sensor_sd**-2)), np.zeros_like(v)
    pull[:6], pull[6:k] = -slope, -pose.sensor.parameters / pose.sensor_sd**2
    for _ in range(N_STRENGTHS):
        z, C, strengths, noise = _update(A, v, pull, before, strengths, noise, float(r @ Wr), len(r))
    return _Estimate(left, z, C, strengths, noise)


def _update(
    A: Matrix,
    v: np.ndarray,
    pull: np.ndarray,
    before: Matrix,
    strengths: Scalars,
    noise: float,
    power: float,
    n_rows: int,
) -> tuple[np.ndarray, Matrix, Scalars, float]:
    """Solve for all unknowns, then update strengths and noise towards their maximum likelihood."""
    k = len(before)
    C = np.linalg.inv(A / noise + block_diag(before, np.diag(1 / strengths)))
    z = C @ (v / noise + pull)
    weights2, spread = z[k:] ** 2, np.diag(C)[k:]
    # How far the data, not the prior, determine a charge.
    determined = np.clip(1 - spread / strengths, 1e-6, 1.0)
    residual2 = power - 2 * float(z @ v) + float(z @ A @ z)
    noise = max(1.0, residual2 / max(n_rows - k - float(determined.sum()), 1.0))
    # Between the slow, certain update of expectation maximisation and MacKay's fixed point.
    more_likely = np.sqrt(weights2 / determined * (weights2 + spread))
    return z, C, np.maximum(more_likely, EPS * more_likely.max(initial=0.0)), noise


def _log_likelihood(
    A: Matrix, v: np.ndarray, before: Matrix, strengths: Scalars, noise: float, power: float, n_rows: int
) -> float:
    """Log marginal likelihood of the data, minus that of the stated noise alone."""
    P = A / noise + block_diag(before, np.diag(1 / strengths))
    fit = float(v @ np.linalg.solve(P, v)) / noise**2
    log_det = np.linalg.slogdet(P)[1] + float(np.log(strengths).sum()) - np.linalg.slogdet(before)[1]
    return -0.5 * float(power / noise - fit + n_rows * np.log(noise) + log_det)


def _log_ratio(lookup: Lookup, samples: _Samples, gram: Matrix, estimate: _Estimate) -> float:
    """Log of 'the base and a sparse change explain the samples' over 'a sparse field of their own does'."""
    left, r = estimate.charges, lookup.residual.ravel()
    Wr = samples.weight * r
    charges = samples.charges[:, left]
    nothing = np.zeros((0, 0))
    explained = _log_likelihood(
        gram[np.ix_(left, left)], charges.T @ Wr, nothing, estimate.strengths, estimate.noise, float(r @ Wr), len(r)
    )
    b, constant = samples.field.ravel(), np.tile(np.eye(3), (len(samples.field), 1))
    Wb, Wc = samples.weight * b, samples.weight[:, None] * constant
    cross = Wc.T @ samples.charges
    A = np.block([[Wc.T @ constant, cross], [cross.T, gram]])
    v = np.concatenate([constant.T @ Wb, samples.charges.T @ Wb])
    before, power = np.eye(3) / CONSTANT_SD**2, float(b @ Wb)
    strengths, noise = np.full(len(gram), float(samples.field.var(axis=0).mean())), MAX_MISFIT**2
    for _ in range(MOST_STEPS * N_STRENGTHS):
        lasting = np.concatenate([[True] * 3, strengths > FADED * strengths.max()])
        A, v, strengths = A[np.ix_(lasting, lasting)], v[lasting], strengths[lasting[3:]]
        _, _, strengths, noise = _update(A, v, np.zeros_like(v), before, strengths, noise, power, len(b))
    return explained - _log_likelihood(A, v, before, strengths, noise, power, len(b))


def _residual_block(
    lookup: Lookup, samples: _Samples, gram: Matrix, pose: RefinedPose, estimate: _Estimate, drift: Drift
) -> ResidualBlock:
    """Information of the samples on pose and sensor, marginalised over the charges."""
    n, k, left = len(lookup.positions), 6 + len(pose.sensor_sd), estimate.charges
    charges = samples.charges[:, left]
    J = residual_jacobian(lookup, pose).reshape(3 * n, k)
    weight = samples.weight / estimate.noise
    stiff = gram[np.ix_(left, left)] / estimate.noise + np.diag(1 / estimate.strengths)
    free = J - charges @ np.linalg.solve(stiff, charges.T @ (weight[:, None] * J))
    rest = lookup.residual.ravel() - charges @ estimate.values[k:]
    WJ = weight[:, None] * free
    information = WJ.T @ J / SELECTION_INFLATION
    return ResidualBlock(
        information=information,
        curvature=information,
        scores=(WJ * rest[:, None]).reshape(n, 3, k).sum(axis=1) / np.sqrt(SELECTION_INFLATION),
        positions=lookup.positions,
        residual2=(rest**2).reshape(n, 3).sum(axis=1) * samples.weight[::3],
        drift=drift.score_covariance(WJ.reshape(n, 3, k), lookup.gradient, samples.rows) / SELECTION_INFLATION,
    )
