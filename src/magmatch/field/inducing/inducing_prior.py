# SPDX-License-Identifier: BSD-3-Clause
"""A Gaussian process over inducing points on a grid, plus a constant field: what such priors share."""

import logging
from dataclasses import replace

import numpy as np
from scipy.spatial import cKDTree

from magmatch.field.hyperparameters import Hyperparameters
from magmatch.field.inducing.calibration import SMALLEST_SD
from magmatch.field.inducing.gaussian_grid import GaussianGrid, InducingGrid, lay_affordable_grid
from magmatch.field.inducing.inducing_model import InducingModel, dense_prior
from magmatch.field.inducing.kernels import Kernel, Term
from magmatch.field.inducing.marginal_likelihood import ScaleFit, choose_samples, fit_at, fit_lengthscale
from magmatch.field.linear_model import check_samples
from magmatch.field.spline.spline_prior import CONSTANT_SD
from magmatch.typing import Points, Vectors

log = logging.getLogger(__name__)

MIN_SAMPLES = 4
# More samples take minutes with thousands of dense weights.
MOST_SAMPLES = 30_000
# Nodes farther apart than wished by more than this lose what the field holds.
_AFFORDABLE_WIDENING = 1.3
# Spacing of the inducing points over the lengthscale; docs/tried.md has figures. Closer nodes than the lesser add
# nothing but rounding, whatever spacing is asked for.
SPACING_RATIO, MIN_SPACING_RATIO = 0.7, 0.5
# How near to a sample the field counts as known, in lengthscales.
_KNOWN_RATIO = 0.75
# Added to the diagonal of the inducing points' covariance, relative to the variance of one component.
JITTER = 1e-9
# Samples for choosing the hyperparameters.
_N_LIKELIHOOD_SAMPLES = 300


class InducingPrior:
    """Lays inducing points over a survey; cost grows with samples times weights squared."""

    is_calibrated = False

    def __init__(
        self,
        name: str,
        kernel_terms: tuple[Term, ...],  # the field's covariance
        terms: tuple[Term, ...],  # what the weights of the inducing points stand for
        most: int,  # inducing points; more would make the spacing, and if need be the lengthscale, wider
        constant_sd: float = CONSTANT_SD,  # T; 0 for none, as published
    ) -> None:
        self.name, self.kernel_terms, self.terms = name, kernel_terms, terms
        self.most, self.constant_sd = most, constant_sd

    def choose_hyperparameters(self, points: Points, field: Vectors) -> Hyperparameters:
        """Numbers by restricted marginal likelihood, the lengthscale no smaller than the cap on nodes allows."""
        check_samples(points, field, MIN_SAMPLES)
        extent = float(np.linalg.norm(np.ptp(points, axis=0)))
        if float(field.std(axis=0).max()) < SMALLEST_SD or extent == 0:
            # Nothing varies, or nothing can be told from noise: any numbers do, these give flat answers.
            sd = max(float(field.std(axis=0).max()), SMALLEST_SD)
            lengthscale = max(extent / 2, 1.0)
            return self._resolved(points, ScaleFit(lengthscale, sd, sd, 0.0))
        n = _N_LIKELIHOOD_SAMPLES
        # Beyond half the extent a field cannot be told from a gradient or two.
        bounds = extent / 100, extent / 2
        fit = fit_lengthscale(self._unit_kernel, points, field, bounds, n)
        grid = self._grid(points, SPACING_RATIO * fit.scale, None)
        affordable = grid.spacing / SPACING_RATIO
        if affordable > fit.scale * (1 + 1e-9):
            log.warning(
                "lengthscale %.3g m instead of %.3g m: %d inducing points cannot cover the survey more finely",
                affordable, fit.scale, self.most,
            )  # fmt: skip
            rows = choose_samples(points, field, n)
            fit = fit_at(self._unit_kernel(affordable), points[rows], field[rows])
        return self._resolved(points, fit)

    def is_affordable(self, points: Points, length: float) -> bool:
        """Whether the inducing points allowed follow a field's typical length (m)."""
        if len(points) > MOST_SAMPLES or length == 0:
            return False
        wished = SPACING_RATIO * length
        return self._grid(points, wished, None).spacing <= _AFFORDABLE_WIDENING * wished

    def build(self, points: Points, field: Vectors, hyperparameters: Hyperparameters) -> InducingModel:
        """Lay inducing points over the surroundings of the points."""
        check_samples(points, field, MIN_SAMPLES)
        h = hyperparameters
        grid = self._grid(points, max(h.spacing, MIN_SPACING_RATIO * h.lengthscale), h.lengthscale)
        if grid.spacing > 1.5 * h.lengthscale:
            log.warning(
                "inducing points %.3g m apart for a lengthscale of %.3g m: the field between them is lost",
                grid.spacing, h.lengthscale,
            )  # fmt: skip
        basis = GaussianGrid(grid, h.lengthscale, self.terms)
        return InducingModel(
            replace(h, spacing=grid.spacing), basis, self._unit_kernel(h.lengthscale), self.constant_sd,
            dense_prior(basis.gram(), h, self.constant_sd, JITTER), cKDTree(points),
            _KNOWN_RATIO * h.lengthscale,
        )  # fmt: skip

    def _grid(self, points: Points, spacing: float, lengthscale: float | None) -> InducingGrid:
        """Inducing points as far as a lengthscale beyond the samples, or one in proportion to the spacing."""

        def reach_at(h: float) -> float:
            return h / SPACING_RATIO if lengthscale is None else lengthscale

        return lay_affordable_grid(points, spacing, reach_at, self.most)

    def _resolved(self, points: Points, fit: ScaleFit) -> Hyperparameters:
        """Numbers of a fit, with the spacing that the cap on nodes allows."""
        grid = self._grid(points, SPACING_RATIO * fit.scale, fit.scale)
        return Hyperparameters(fit.scale, fit.signal_sd, fit.noise_sd, grid.spacing)

    def _unit_kernel(self, lengthscale: float) -> Kernel:
        return Kernel(self.kernel_terms, lengthscale)
