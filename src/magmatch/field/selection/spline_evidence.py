# SPDX-License-Identifier: BSD-3-Clause
"""Marginal likelihood of the spline's hyperparameters, with the noise profiled out, and tempered for a path.

With everything in units of the noise, ``A = sum Phi^T Phi + P0``, the likelihood of n measured values is greatest at
``noise^2 = S / n``, ``S = sum |b|^2 - eta^T A^-1 eta``, where

    log p = -1/2 [ n / kappa ln(S / n) + ln det A - ln det P0 ].

Along a path errors are correlated (poses drift, steel varies the field at small scale); if they were taken as
independent, the field would fit them. kappa is the integrated autocorrelation time of the residuals, in samples.

With ``P0`` proportional to the noise's square and t its logarithm, for S and A of `spline_evidence`

    dS/dt = q = w^T P0 w,    dq/dt = q - 2 w^T P0 A^-1 P0 w,
    d ln det A/dt = T = tr A^-1 P0,    dT/dt = T - tr (A^-1 P0)^2,    d ln det P0/dt = m.

T is the mean of ``u^T P0 u`` over draws u of covariance ``A^-1`` (Hutchinson 1989, doi:10.1080/03610918908812806).
"""

from dataclasses import dataclass, replace

import numpy as np

from magmatch.field.cholesky.cells import lay_cells
from magmatch.field.cholesky.multifrontal import CholeskyFactor, Factors, factorise
from magmatch.field.cholesky.nested_dissection import Elimination, order_elimination
from magmatch.field.cholesky.stencil_matrix import StencilMatrix
from magmatch.field.folds import has_path_order
from magmatch.field.hyperparameters import Hyperparameters
from magmatch.field.spline.spline_model import SplineInformation, SplineModel, SplinePosterior
from magmatch.field.spline.spline_prior import constant_precision, relative_prior_precision
from magmatch.geometry import typical_step
from magmatch.typing import Indices, Mask, Points, Scalars, Vectors

# The top of the evidence is off by a few hundredths of the noise with so many.
N_PROBES = 4
# Correlations below this end the sum: what follows is scatter of the estimate.
SMALLEST_CORRELATION = 0.1
# Longest autocorrelation time, samples: what is correlated over longer stretches lives in few directions, and
# the rest of what those samples say stands.
LONGEST_AUTOCORRELATION = 16.0
# `SplineModel.information_ratio` beyond which rounding in single precision would be seen in the evidence.
HIGHEST_INFORMATION_RATIO = 1e6
# Spacing, reach, lengthscale and divergence_weight: signal and noise only scale the prior.
Shape = tuple[float, float, float, float]


@dataclass(frozen=True, slots=True)
class NoiseSlopes:
    """First and second derivatives by the logarithm of the assumed noise level.

    ``evidence``: of the tempered log evidence; ``level``: of the log of the noise level of the greatest likelihood.
    """

    evidence: tuple[float, float]
    level: tuple[float, float]


@dataclass(frozen=True, slots=True)
class TrialFit:
    """Result of one factorisation with trial numbers: S (T^2), ``ln det A`` and the posterior mean (m + 3,)."""

    square: float
    log_determinant: float
    weights: Scalars


class EvidenceSearch:
    """Evidence of trial hyperparameters for given samples, each computed once."""

    def __init__(
        self, points: Points, field: Vectors, order: Indices, precision: type[np.floating] = np.float64
    ) -> None:
        self.points, self.field, self.order, self.precision = points, field, order, precision
        self.autocorrelation_time = 1.0
        # By spacing and reach.
        self._bases: dict[tuple[float, float], Elimination] = {}
        self._data: dict[tuple[float, float], SplineInformation] = {}
        self._fits: dict[Hyperparameters, TrialFit] = {}
        # The last fit's: slopes are asked for at once or not at all.
        self._last: tuple[Hyperparameters, CholeskyFactor] | None = None
        self._shapes: dict[Shape, StencilMatrix] = {}
        self._log_determinants: dict[Shape, float] = {}

    @property
    def n_independent(self) -> float:
        """Measured values, fewer where neighbouring samples are correlated."""
        return self.field.size / self.autocorrelation_time

    def operations(self, h: Hyperparameters) -> float:
        """Floating-point operations of one factorisation."""
        return self._model(h).elimination.n_operations

    def log_evidence(self, h: Hyperparameters) -> float:
        """Tempered log marginal likelihood with the noise profiled out; only ``signal_sd / noise_sd`` matters.

        Minus infinity if the numbers cannot be used.
        """
        try:
            return self.log_evidence_of_noise(h) + 0.5 * self._log_determinant(h)
        except np.linalg.LinAlgError:
            return -np.inf

    def log_evidence_of_noise(self, h: Hyperparameters) -> float:
        """Give it up to a number that only depends on spacing, reach, lengthscale and divergence_weight."""
        try:
            fit = self._fit(h)
        except np.linalg.LinAlgError:
            return -np.inf
        n = float(self.field.size)
        log_prior = self._model(h).cells.n_nodes * np.log(relative_prior_precision(h)) + 3 * np.log(
            constant_precision(h)
        )
        likelihood = self.n_independent * np.log(fit.square / n)
        return float(-0.5 * (likelihood + fit.log_determinant - log_prior))

    def noise_sd(self, h: Hyperparameters) -> float:
        """Maximum-likelihood noise level, T."""
        return float(np.sqrt(self._fit(h).square / self.field.size))

    def noise_slopes(self, h: Hyperparameters) -> NoiseSlopes:
        """Give the slopes of evidence and noise level with the noise, at numbers of finite evidence."""
        if self._last is None or self._last[0] != h:
            self._last = h, self._factor(h, self._observed(h), self.precision)[1]
        factor, fit, n = self._last[1], self._fit(h), self.n_independent
        m = len(fit.weights)
        draws = factor.solve_half(2.0 * np.random.default_rng(0).integers(0, 2, (m, N_PROBES)) - 1)
        products = np.stack([self._times_prior(h, column) for column in (*draws.T, fit.weights)], axis=1)
        squares = np.einsum("ij,ij->j", products, factor.solve(products))
        trace = float(np.einsum("ij,ij->", products[:, :-1], draws)) / N_PROBES
        q, trace_of_square = float(products[:, -1] @ fit.weights), float(squares[:-1].mean())
        slope = q / fit.square
        bend = (q - 2 * float(squares[-1])) / fit.square - slope**2
        evidence = -0.5 * (n * slope + trace - m), -0.5 * (n * bend + trace - trace_of_square)
        # The noise's logarithm is half of t; a level is the root of its square.
        return NoiseSlopes((2 * evidence[0], 4 * evidence[1]), (slope, 2 * bend))

    def temper(self, h: Hyperparameters) -> None:
        """Set how many neighbouring samples of a path count as one, from the autocorrelation of a fit's residuals."""
        in_a_quarter_cell = 1.0
        step = np.linalg.norm(np.diff(self.points, axis=0), axis=1)[np.diff(self.order) == 1]
        if len(step) and has_path_order(self.points):
            # These share what the model cannot follow there.
            in_a_quarter_cell = h.spacing / 4 / max(typical_step(step), 1e-300)
        mean = SplinePosterior(h, self._model(h).cells, Factors.gone(), self._fit(h).weights)
        residual = self.field - mean.evaluate(self.points).field
        correlated = integrated_autocorrelation_time(residual, self.order)
        self.autocorrelation_time = max(correlated, float(np.clip(in_a_quarter_cell, 1.0, LONGEST_AUTOCORRELATION)))

    def fit_without(self, rows: Mask, h: Hyperparameters) -> SplinePosterior:
        """Posterior without some samples."""
        model, data = self._model(h), self._observed(h)
        rest = data - model.observe(self.points[rows], self.field[rows])
        try:
            A, factor = self._factor(h, rest, self.precision)
        except np.linalg.LinAlgError:
            # The numbers were chosen with all samples; without some, noise as small may be too much for fewer digits.
            A, factor = self._factor(h, rest, np.float64)
        w, _, change = _solve(A, factor, rest.eta)
        return SplinePosterior(h, model.cells, Factors.of(factor), w + change)

    def _times_prior(self, h: Hyperparameters, x: Scalars) -> Scalars:
        """Give ``P0 x``."""
        product = relative_prior_precision(h) * self._shape(h).times(x, self._model(h).cells)
        product[-3:] = constant_precision(h) * x[-3:]
        return product

    def _model(self, h: Hyperparameters) -> SplineModel:
        """Splines over all samples; those of one spacing and reach are laid once."""
        key = (h.spacing, h.reach)
        if key not in self._bases:
            self._bases[key] = order_elimination(lay_cells(self.points, *key))
        return SplineModel(h, self._bases[key])

    def _observed(self, h: Hyperparameters) -> SplineInformation:
        """Collect the samples' information on splines of one spacing and reach, once."""
        key = (h.spacing, h.reach)
        if key not in self._data:
            self._data[key] = self._model(h).observe(self.points, self.field)
        return self._data[key]

    def _fit(self, h: Hyperparameters) -> TrialFit:
        if h not in self._fits:
            data = self._observed(h)
            A, factor = self._factor(h, data, self.precision)
            self._last = h, factor
            w, left, change = _solve(A, factor, data.eta)
            # The first solution's value, which is off by the square of its error; and that square.
            square = data.square - float((data.eta + left) @ w) - float(left @ change)
            # Rounding errors may not pass for a perfect fit.
            square = max(square, 1e-12 * data.square, 1e-300)
            self._fits[h] = TrialFit(square, factor.log_determinant, w + change)
        return self._fits[h]

    def _factor(
        self, h: Hyperparameters, data: SplineInformation, precision: type[np.floating]
    ) -> tuple[StencilMatrix, CholeskyFactor]:
        """Posterior precision and its factor, in single precision where asked and possible."""
        model = self._model(h)
        stencil = self._shape(h).stencil * relative_prior_precision(h)
        stencil += data.gram.stencil
        corner = data.gram.corner + np.eye(3) * constant_precision(h)
        A = StencilMatrix(stencil, data.gram.border, corner)
        is_risky = precision == np.float32 and model.information_ratio(data) > HIGHEST_INFORMATION_RATIO
        return A, factorise(model.elimination, A, np.float64 if is_risky else precision)

    def _shape(self, h: Hyperparameters) -> StencilMatrix:
        """Prior precision where signal and noise are the same, of which theirs is a multiple."""
        key = _shape_of(h)
        if key not in self._shapes:
            unit = replace(h, signal_sd=1.0, noise_sd=1.0, prior_scale=1.0)
            self._shapes[key] = replace(self._model(h), hyperparameters=unit).prior_precision()
            self._shapes[key].corner[:] = np.eye(3)
        return self._shapes[key]

    def _log_determinant(self, h: Hyperparameters) -> float:
        """Factorise the prior's shape once for its log-determinant."""
        key = _shape_of(h)
        if key not in self._log_determinants:
            factor = factorise(self._model(h).elimination, self._shape(h), self.precision)
            self._log_determinants[key] = factor.log_determinant
        return self._log_determinants[key]


def _shape_of(h: Hyperparameters) -> Shape:
    return (h.spacing, h.reach, h.lengthscale, h.divergence_weight)


def _solve(A: StencilMatrix, factor: CholeskyFactor, rhs: Scalars) -> tuple[Scalars, Scalars, Scalars]:
    """Solution, what it leaves, and how that changes it: the difference of large numbers counts."""
    w = factor.solve(rhs)
    left = rhs - A.times(w, factor.elimination.cells)
    return w, left, factor.solve(left)


def integrated_autocorrelation_time(residuals: Vectors, order: Indices) -> float:
    """Give the number of neighbouring samples of a path that count as one measurement (Sokal 1997).

    ``1 + 2 sum of the autocorrelation`` up to where it fades, at most 16; samples left out leave gaps in ``order``.
    """
    mean: Scalars = (residuals**2).sum(axis=1)
    if not mean.any():
        return 1.0
    total = 1.0
    for lag in range(1, len(residuals) // 3):
        together = order[lag:] - order[:-lag] == lag
        if not together.any():
            break
        product = (residuals[lag:] * residuals[:-lag]).sum(axis=1)[together]
        correlation = float(product.mean() / mean.mean())
        if correlation < SMALLEST_CORRELATION:
            break
        total += 2 * correlation
        if total > LONGEST_AUTOCORRELATION:
            break
    return min(total, LONGEST_AUTOCORRELATION)
