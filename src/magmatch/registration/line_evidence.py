# SPDX-License-Identifier: BSD-3-Clause
"""Refine and weigh poses of a walk by generalised least squares with the covariance that residuals along a path have.

Residuals are taken in the walk's axes, ``r = b - R^T B_base(T y)``, with the pose perturbed about the walk's centre c,
``T Exp(xi)``: Jacobian ``[-[b]x + G [y - c]x, -G]``, G the base's gradient in the walk's axes.
"""

from dataclasses import dataclass
from itertools import product

import numpy as np
from pydantic import BaseModel, ConfigDict, Field
from scipy.linalg import cholesky, solve_triangular
from scipy.spatial.distance import cdist
from scipy.spatial.transform import RigidTransform

from magmatch.geometry import skew, transform_points
from magmatch.registration.path_noise import PathNoise
from magmatch.registration.prepared import PreparedMap
from magmatch.registration.refinement import perturbation
from magmatch.registration.walk import Walk
from magmatch.typing import Covariance6, Mask, Matrix, Scalars, Tensors, Vector3, Vectors

# Longest step: rad, and in lengthscales.
MAX_TURN, MAX_SHIFT = 0.15, 0.4
# Spread of a pose that the data leave free: what the search hands over is nearer than this. Rad, and in lengthscales.
FREE_TURN, FREE_SHIFT = 0.5, 2.0
# Unrelated field: tried lengthscales (in the map's) and strengths (in the walk's own standard deviation).
NULL_LENGTHSCALES = (0.7, 1.0, 1.5, 2.2, 3.3)
NULL_STRENGTHS = (0.5, 1.0, 2.0, 4.0)
# Every so many-th bin decides which unrelated field is the most likely.
NULL_BINS = 60


class LineConfig(BaseModel):
    """Settings of the generalised least squares."""

    model_config = ConfigDict(frozen=True, extra="forbid")

    # Steps with like components, then steps that know how drifting poses couple them.
    n_coarse_steps: int = Field(default=5, ge=0)
    n_fine_steps: int = Field(default=2, ge=1)
    # Poses that take the fine steps.
    n_fine: int = Field(default=4, ge=1)
    # Fewest bins, and their share, that a pose must put inside the base map.
    min_bins: int = Field(default=8, ge=7)
    min_coverage: float = Field(default=0.3, gt=0, le=1)
    # Largest factor on the learned covariance that a pose may ask for.
    max_inflation: float = Field(default=4.0, ge=1)


@dataclass(frozen=True, eq=False, slots=True)
class LineEvidence:
    """One pose of a walk at the optimum.

    Attributes
    ----------
    T_base_walk : RigidTransform
        Base model frame from the walk's frame.
    center : (3,) array, m
        Point of the walk about which the covariance is stated, walk's frame.
    covariance : (6, 6) array
        Of xi in ``T Exp(xi)`` about the centre; rotation first (rad, m), walk's axes.
    coverage : float
        Share of the bins inside the base map.
    log_evidence : float, nats
        ``log p(b | pose) - log p(b | unrelated) + 1/2 ln det 2 pi C - ln(volume 8 pi^2)``.
    residual : float
        Normalised rms residual (1 when the covariance explains everything).
    is_covered : (n,) bool array
        Bins inside the base map.
    """

    T_base_walk: RigidTransform
    center: Vector3
    covariance: Covariance6
    coverage: float
    log_evidence: float
    residual: float
    is_covered: Mask


def weigh_walk(
    base: PreparedMap, walk: Walk, starts: list[RigidTransform], noise: PathNoise, config: LineConfig
) -> list[LineEvidence]:
    """Refine poses of a walk and order them by their evidence.

    Parameters
    ----------
    base : PreparedMap
    walk : Walk
    starts : list of RigidTransform
        Base model frame from the walk's frame.
    noise : PathNoise
    config : LineConfig

    Returns
    -------
    list of LineEvidence
        Best first; poses that leave the base map are dropped.
    """
    distance = cdist(walk.positions, walk.positions)
    null = UnrelatedWalk.most_likely(walk, distance, noise, base.lengthscale)
    coarse = [_refine(base, walk, T, distance, noise, config, is_full=False) for T in starts]
    found = sorted(
        (f for f in coarse if f is not None), key=lambda f: -f.log_likelihood + null.log_likelihood(f.known)
    )
    fine = [_refine(base, walk, f.T, distance, noise, config, is_full=True) for f in found[: config.n_fine]]
    weighed = [_weigh(f, walk, null, base.raster.volume, config) for f in (*fine, *found[config.n_fine :]) if f]
    return sorted(weighed, key=lambda e: -e.log_evidence)


@dataclass(frozen=True, eq=False, slots=True)
class UnrelatedWalk:
    """The walk's field as a smooth random field of its own, the most likely one: what a pose has to beat."""

    field: Vectors
    covariance: Matrix

    @classmethod
    def most_likely(cls, walk: Walk, distance: Matrix, noise: PathNoise, lengthscale: float) -> "UnrelatedWalk":
        """Choose lengthscale and strength by the likelihood of the walk's field."""
        n = len(walk)
        some = np.unique(np.linspace(0, n - 1, min(n, NULL_BINS)).astype(np.int64))
        d2 = distance[np.ix_(some, some)] ** 2
        spread2 = float(walk.field.var(axis=0).mean()) + noise.nugget_sd**2
        constant = float((walk.field**2).sum(axis=1).mean()) / 3
        best, chosen = -np.inf, (1.0, spread2)
        for factor, strength in product(NULL_LENGTHSCALES, NULL_STRENGTHS):
            length, variance = factor * lengthscale, strength**2 * spread2
            K = _unrelated_covariance(d2, length, variance, constant, noise)
            found = _log_likelihood(walk.field[some], K)
            if found > best:
                best, chosen = found, (length, variance)
        return cls(walk.field, _unrelated_covariance(distance**2, *chosen, constant, noise))

    def log_likelihood(self, rows: Mask) -> float:
        """Log density of some bins' field (the factor of 2 pi left out)."""
        return _log_likelihood(self.field[rows], self.covariance[np.ix_(rows, rows)])


@dataclass(frozen=True, eq=False, slots=True)
class _Fit:
    """A pose at the optimum for one covariance model."""

    T: RigidTransform
    center: Vector3
    known: Mask
    information: Matrix
    chi2: float
    half_log_det: float

    @property
    def log_likelihood(self) -> float:
        return -0.5 * self.chi2 - self.half_log_det


def _refine(
    base: PreparedMap,
    walk: Walk,
    T: RigidTransform,
    distance: Matrix,
    noise: PathNoise,
    config: LineConfig,
    *,
    is_full: bool,
) -> _Fit | None:
    """Gauss-Newton; the last step only states chi^2 and information."""
    center = walk.positions.mean(axis=0)
    scale = np.repeat([MAX_TURN, MAX_SHIFT * base.lengthscale], 3)
    free = np.repeat([FREE_TURN, FREE_SHIFT * base.lengthscale], 3)
    n_steps = config.n_fine_steps if is_full else config.n_coarse_steps
    for step in range(n_steps + 1):
        y = transform_points(walk.positions, T)
        _, sd, _, known = base.raster.lookup(y)
        if known.sum() < max(config.min_bins, config.min_coverage * len(walk)):
            return None
        residual, J, G = _linearise(base, walk, T, center, known)
        d = distance[np.ix_(known, known)]
        if is_full:
            L = _cholesky(noise.full(d, sd[known], base.lengthscale, G))
            z, half_log_det = _solve(L, residual.ravel()), float(np.log(np.diag(L)).sum())
            JW = _solve(L, J.reshape(-1, 6))
        else:
            # Like components: one small factor serves all three.
            drift2 = noise.drift_sd**2 * float(np.mean(G**2)) * 3
            C = noise.isotropic(d, sd[known], base.lengthscale) + drift2 * np.exp(-d / noise.drift_length)
            L = _cholesky(C)
            z, half_log_det = _solve(L, residual).ravel(), 3 * float(np.log(np.diag(L)).sum())
            JW = _solve(L, J.reshape(len(residual), 18)).reshape(-1, 6)
        A, v = JW.T @ JW + np.diag(free**-2), JW.T @ z
        if step == n_steps:
            return _Fit(T, center, known, A, float(z @ z), half_log_det)
        xi = -np.linalg.solve(A, v)
        T = T * perturbation(xi / max(1.0, float(np.abs(xi / scale).max())), center)
    return None


def _linearise(
    base: PreparedMap, walk: Walk, T: RigidTransform, center: Vector3, known: Mask
) -> tuple[Vectors, Tensors, Tensors]:
    """Residual, its Jacobian (n, 3, 6) and the base's gradient, walk's axes."""
    y, b = walk.positions[known], walk.field[known]
    values = base.field_map.posterior.evaluate(transform_points(y, T), order=1).rotated(T.inv())
    if values.gradient is None:
        msg = "the posterior gave no gradient although order 1 was asked for"
        raise ValueError(msg)
    G = values.gradient
    J = np.concatenate([G @ skew(y - center) - skew(b), -G], axis=2)
    return b - values.field, J, G


def _weigh(fit: _Fit, walk: Walk, null: UnrelatedWalk, volume: float, config: LineConfig) -> LineEvidence:
    n = 3 * int(fit.known.sum())
    # The pose itself took six degrees of freedom.
    inflation = float(np.clip(fit.chi2 / (n - 6), 1.0, config.max_inflation))
    log_likelihood = -0.5 * fit.chi2 / inflation - fit.half_log_det - 0.5 * n * np.log(inflation)
    covariance = inflation * np.linalg.inv(fit.information)
    _, log_det = np.linalg.slogdet(2 * np.pi * covariance)
    price = 0.5 * log_det - np.log(max(volume, np.finfo(float).tiny) * 8 * np.pi**2)
    return LineEvidence(
        T_base_walk=fit.T,
        center=fit.center,
        covariance=(covariance + covariance.T) / 2,
        coverage=float(fit.known.mean()),
        log_evidence=float(log_likelihood - null.log_likelihood(fit.known) + price),
        residual=float(np.sqrt(fit.chi2 / (n - 6))),
        is_covered=fit.known,
    )


def _unrelated_covariance(d2: Matrix, length: float, variance: float, constant: float, noise: PathNoise) -> Matrix:
    # Rational quadratic: a mixture of lengthscales, as the field of sources at many distances is.
    K: Matrix = variance / (1 + d2 / (2 * length**2)) + constant + noise.nugget_sd**2 * np.eye(len(d2))
    return K


def _log_likelihood(values: Vectors, K: Matrix) -> float:
    L = _cholesky(K)
    z = _solve(L, values)
    return float(-0.5 * (z**2).sum() - 3 * np.log(np.diag(L)).sum())


def _cholesky(C: Matrix) -> Matrix:
    return np.asarray(cholesky(C, lower=True, check_finite=False, overwrite_a=True))


def _solve(L: Matrix, rows: Matrix | Scalars) -> Matrix:
    return np.asarray(solve_triangular(L, rows, lower=True, check_finite=False))
