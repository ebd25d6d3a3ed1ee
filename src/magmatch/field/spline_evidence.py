# SPDX-License-Identifier: BSD-3-Clause
"""Marginal likelihood of the spline prior's numbers, with the noise level profiled out and tempered for a path.

With everything in units of the noise, ``A = sum Phi^T Phi + P0``, the likelihood of n measured values is greatest at
``noise^2 = S / n``, ``S = sum |b|^2 - eta^T A^-1 eta``, where

    log p = -1/2 [ n / kappa ln(S / n) + ln det A - ln det P0 ].

Along a path errors are correlated (poses drift, steel moves the field at small scale); taken as independent they make
the evidence follow them. kappa is how many samples count as one: the integral of the residuals' autocorrelation.
"""

from dataclasses import dataclass, replace
from functools import partial

import numpy as np

from magmatch.field.cells import CellGrid, lay_cells
from magmatch.field.held_out import has_path_order
from magmatch.field.hyperparameters import Hyperparameters
from magmatch.field.multifrontal import CholeskyFactor, FactorMemory, factorise
from magmatch.field.nested_dissection import Elimination, order_elimination
from magmatch.field.spline_model import CONSTANT_SD, SplineInformation, SplineModel, SplinePosterior
from magmatch.field.stencil_matrix import StencilMatrix
from magmatch.typing import Indices, Points, Scalars, Vectors

# Correlations below this end the sum: what follows is scatter of the estimate.
SMALLEST_CORRELATION = 0.1
# More than so many samples never count as one: what is correlated over longer stretches lives in few directions, and
# the rest of what those samples say stands.
MOST_SAMPLES_AS_ONE = 16.0
# Measured values per cell over the prior's share: beyond, rounding in single precision would be seen.
HIGHEST_CONTRAST = 1e6


@dataclass(frozen=True, slots=True)
class Fit:
    """What one factorisation tells about trial numbers.

    Attributes
    ----------
    square : float, T^2
        S, what the prior and the noise have to explain.
    log_ratio : float
        ``ln det A - ln det P0``.
    weights : (m + 3,) array, T
        Posterior mean.
    """

    square: float
    log_ratio: float
    weights: Scalars


@dataclass(frozen=True, eq=False, slots=True)
class Basis:
    """What trials of one spacing and reach share."""

    cells: CellGrid
    elimination: Elimination
    information: SplineInformation
    memory: FactorMemory


@dataclass(frozen=True, eq=False, slots=True)
class PriorShape:
    """Prior precision where signal and noise are the same, of which theirs is a multiple, and its log-determinant."""

    stencil: np.ndarray
    log_determinant: float


class EvidenceSearch:
    """Evidence of trial hyperparameters for given samples, each computed once.

    Parameters
    ----------
    points : (n, 3) array, m
    field : (n, 3) array, T
    order : (n,) int array
        Place of each sample along its path; neighbours in it are one apart.
    precision : numpy type
        Of the factors: single is twice as fast and shifts the evidence by a tenth; where that would not do, double is
        taken all the same.
    """

    def __init__(
        self, points: Points, field: Vectors, order: Indices, precision: type[np.floating] = np.float64
    ) -> None:
        self.points, self.field, self.order, self.precision = points, field, order, precision
        self.samples_as_one = 1.0
        self._bases: dict[tuple[float, float], Basis] = {}
        self._fits: dict[Hyperparameters, Fit] = {}
        self._shapes: dict[tuple[float, float, float, float], PriorShape] = {}

    def operations(self, h: Hyperparameters) -> float:
        """Floating-point operations of one factorisation."""
        return self._basis(h).elimination.n_operations

    def log_evidence(self, h: Hyperparameters) -> float:
        """Tempered log marginal likelihood with the noise profiled out; only ``signal_sd / noise_sd`` matters.

        Minus infinity where the numbers cannot be used.
        """
        try:
            fit = self._fit(h)
        except np.linalg.LinAlgError:
            return -np.inf
        n = float(self.field.size)
        return -0.5 * (n / self.samples_as_one * float(np.log(fit.square / n)) + fit.log_ratio)

    def noise_sd(self, h: Hyperparameters) -> float:
        """Noise level of the greatest likelihood, T."""
        return float(np.sqrt(self._fit(h).square / self.field.size))

    def residuals(self, h: Hyperparameters) -> Vectors:
        """What the fitted mean leaves of the samples, (n, 3), T."""
        basis = self._basis(h)
        model = SplineModel(h, basis.cells, basis.elimination)
        posterior = SplinePosterior(h, basis.cells, partial(model.factorise, basis.information), self._fit(h).weights)
        left: Vectors = self.field - posterior.evaluate(self.points).field
        return left

    def correlated_samples(self, h: Hyperparameters) -> float:
        """How many samples count as one by what a fit leaves of them."""
        return correlated_samples(self.residuals(h), self.order)

    def crowded_samples(self, h: Hyperparameters) -> float:
        """How many samples of a path lie in a quarter of a cell, and so share what the model cannot follow there."""
        step = np.linalg.norm(np.diff(self.points, axis=0), axis=1)[np.diff(self.order) == 1]
        if len(step) == 0 or not has_path_order(self.points):
            return 1.0
        return float(np.clip(h.spacing / 4 / max(float(np.median(step)), 1e-300), 1.0, MOST_SAMPLES_AS_ONE))

    def _basis(self, h: Hyperparameters) -> Basis:
        key = (h.spacing, h.reach)
        if key not in self._bases:
            cells = lay_cells(self.points, h.spacing, h.reach)
            model = SplineModel(h, cells, order_elimination(cells))
            memory = FactorMemory(model.elimination, self.precision)
            self._bases[key] = Basis(cells, model.elimination, model.observe(self.points, self.field), memory)
        return self._bases[key]

    def _fit(self, h: Hyperparameters) -> Fit:
        if h not in self._fits:
            basis, scale = self._basis(h), (h.noise_sd / (h.looseness * h.signal_sd)) ** 2
            shape, constant, data = self._shape(h, basis), (h.noise_sd / CONSTANT_SD) ** 2, basis.information
            A = StencilMatrix(
                data.gram.stencil + scale * shape.stencil, data.gram.border, data.gram.corner + constant * np.eye(3)
            )
            factor = self._factorise(basis, A, scale)
            w = factor.solve(data.eta)
            # What the first solution leaves takes its rounding errors away: the difference of large numbers counts.
            left = data.eta - A.times(w, basis.cells)
            w += factor.solve(left)
            left = data.eta - A.times(w, basis.cells)
            square = data.square - float(data.eta @ w) - float(left @ w)
            # Nor may they pass for a perfect fit.
            square = max(square, 1e-12 * data.square, 1e-300)
            log_prior = shape.log_determinant + basis.cells.n_nodes * np.log(scale) + 3 * np.log(constant)
            self._fits[h] = Fit(square, factor.log_determinant - float(log_prior), w)
        return self._fits[h]

    def _factorise(self, basis: Basis, A: StencilMatrix, scale: float) -> CholeskyFactor:
        """Factor in single precision where asked and possible."""
        crowd = self.field.size / basis.cells.n_cells
        if self.precision == np.float32 and crowd > HIGHEST_CONTRAST * scale:
            return factorise(basis.elimination, A)
        return factorise(basis.elimination, A, basis.memory)

    def _shape(self, h: Hyperparameters, basis: Basis) -> PriorShape:
        """Shape of the prior: signal and noise only scale it, so it is factorised once."""
        key = (h.spacing, h.reach, h.lengthscale, h.stiffness)
        if key not in self._shapes:
            unit = replace(h, signal_sd=1.0, noise_sd=1.0, looseness=1.0)
            prior = SplineModel(unit, basis.cells, basis.elimination).prior_precision()
            prior.corner[:] = np.eye(3)
            factor = factorise(basis.elimination, prior, basis.memory)
            self._shapes[key] = PriorShape(prior.stencil, factor.log_determinant)
        return self._shapes[key]


def correlated_samples(residuals: Vectors, order: Indices) -> float:
    """How many neighbouring samples of a path count as one independent measurement.

    Parameters
    ----------
    residuals : (n, 3) array
        Along the path.
    order : (n,) int array
        Place of each sample along it; samples left out leave gaps.

    Returns
    -------
    float
        ``1 + 2 sum of the autocorrelation`` up to where it fades, at most 16; 1 for white residuals.
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
        if total > MOST_SAMPLES_AS_ONE:
            break
    return min(total, MOST_SAMPLES_AS_ONE)
