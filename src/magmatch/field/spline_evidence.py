# SPDX-License-Identifier: BSD-3-Clause
"""Marginal likelihood of the spline prior's numbers, with the noise level profiled out and tempered for a path.

With everything in units of the noise, ``A = sum Phi^T Phi + P0``, the likelihood of n measured values is greatest at
``noise^2 = S / n``, ``S = sum |b|^2 - eta^T A^-1 eta``, where

    log p = -1/2 [ n / kappa ln(S / n) + ln det A - ln det P0 ].

Along a path errors are correlated (poses drift, steel moves the field at small scale); taken as independent they make
the evidence follow them. kappa is how many samples count as one: the integral of the residuals' autocorrelation.
"""

from dataclasses import dataclass, replace

import numpy as np

from magmatch.field.cells import CellGrid, lay_cells
from magmatch.field.held_out import has_path_order
from magmatch.field.hyperparameters import Hyperparameters
from magmatch.field.multifrontal import factorise
from magmatch.field.nested_dissection import Elimination, order_elimination
from magmatch.field.spline_model import SplineInformation, SplineModel
from magmatch.typing import Indices, Points, Scalars, Vectors

# Correlations below this end the sum: what follows is scatter of the estimate.
SMALLEST_CORRELATION = 0.1
# More than so many samples never count as one: what is correlated over longer stretches lives in few directions, and
# the rest of what those samples say stands.
MOST_SAMPLES_AS_ONE = 16.0


@dataclass(frozen=True, slots=True)
class Fit:
    """What one factorisation tells about trial numbers.

    Attributes
    ----------
    square : float, T^2
        S, what the prior and the noise have to explain.
    log_ratio : float
        ``ln det A - ln det P0``.
    """

    square: float
    log_ratio: float


@dataclass(frozen=True, eq=False, slots=True)
class Basis:
    """What trials of one spacing and reach share."""

    cells: CellGrid
    elimination: Elimination
    information: SplineInformation


class EvidenceSearch:
    """Evidence of trial hyperparameters for given samples, each computed once.

    Parameters
    ----------
    points : (n, 3) array, m
    field : (n, 3) array, T
    order : (n,) int array
        Place of each sample along its path; neighbours in it are one apart.
    """

    def __init__(self, points: Points, field: Vectors, order: Indices) -> None:
        self.points, self.field, self.order = points, field, order
        self.samples_as_one = 1.0
        self._bases: dict[tuple[float, float], Basis] = {}
        self._fits: dict[Hyperparameters, Fit] = {}
        self._priors: dict[tuple[float, float, float, float], float] = {}

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
        posterior = SplineModel(h, basis.cells, basis.elimination).infer(basis.information)
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
            self._bases[key] = Basis(cells, model.elimination, model.observe(self.points, self.field))
        return self._bases[key]

    def _fit(self, h: Hyperparameters) -> Fit:
        if h not in self._fits:
            basis = self._basis(h)
            model = SplineModel(h, basis.cells, basis.elimination)
            prior = model.prior_precision()
            factor = factorise(basis.elimination, basis.information.gram + prior)
            square = basis.information.square - float(basis.information.eta @ factor.solve(basis.information.eta))
            # Rounding of the difference of two large numbers must not pass for a perfect fit.
            square = max(square, 1e-12 * basis.information.square, 1e-300)
            self._fits[h] = Fit(square, factor.log_determinant - self._log_prior(h, basis))
        return self._fits[h]

    def _log_prior(self, h: Hyperparameters, basis: Basis) -> float:
        """Log-determinant of the prior precision; the signal only scales it, so it is factorised once per shape."""
        key = (h.spacing, h.reach, h.lengthscale, h.stiffness)
        if key not in self._priors:
            unit = replace(h, signal_sd=1.0, noise_sd=1.0)
            prior = SplineModel(unit, basis.cells, basis.elimination).prior_precision()
            prior.corner[:] = np.eye(3)
            self._priors[key] = factorise(basis.elimination, prior).log_determinant
        corner = SplineModel(h, basis.cells, basis.elimination).prior_precision().corner
        scale = 2 * basis.cells.n_nodes * np.log(h.noise_sd / (h.looseness * h.signal_sd))
        return self._priors[key] + float(scale + np.log(np.diagonal(corner)).sum())


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
