# SPDX-License-Identifier: BSD-3-Clause
"""A Gaussian process over inducing points on a grid, plus a constant field: what such priors share."""

import logging
from dataclasses import replace

import numpy as np
from pydantic import Field
from scipy.spatial import cKDTree

from magmatch.field.hyperparameters import Hyperparameters
from magmatch.field.inducing.calibration import SMALLEST_SD
from magmatch.field.inducing.gaussian_grid import GaussianGrid
from magmatch.field.inducing.inducing_grid import InducingGrid, lay_affordable_grid
from magmatch.field.inducing.inducing_model import InducingModel, dense_prior
from magmatch.field.inducing.kernels import Kernel, Term
from magmatch.field.inducing.marginal_likelihood import ScaleFit, choose_samples, fit_at, fit_lengthscale
from magmatch.field.linear_model import check_samples
from magmatch.field.variogram import typical_length
from magmatch.settings import Settings
from magmatch.typing import Points, Vectors

log = logging.getLogger(__name__)

MIN_SAMPLES = 4
# More samples take minutes with thousands of dense weights.
MOST_SAMPLES = 30_000
# Nodes farther apart than wished by more than this lose what the field holds.
_AFFORDABLE_WIDENING = 1.3


class InducingConfig(Settings):
    """Settings of a Gaussian process over inducing points."""

    # Spacing of the inducing points over the lengthscale; docs/tried.md has figures.
    spacing_ratio: float = Field(default=0.7, gt=0)
    # Closer nodes add nothing but rounding, whatever spacing is asked for.
    min_spacing_ratio: float = Field(default=0.5, gt=0)
    # How far beyond the samples inducing points lie, in lengthscales.
    reach_ratio: float = Field(default=1.0, ge=0)
    # Most inducing points (3 weights each); more makes the spacing, and if need be the lengthscale, wider.
    max_inducing_points: int = Field(default=1200, ge=8)
    # Prior standard deviation of the constant field, T; 0 for none, as published. Broad against the Earth's
    # 25 to 65 uT: a zero-mean field of that size would otherwise dictate lengthscale and signal.
    constant_sd: float = Field(default=1e-4, ge=0)
    # Added to the diagonal of the inducing points' covariance, relative to the variance of one component.
    jitter: float = Field(default=1e-9, gt=0)
    # Distance from a sample within which the field counts as known, in lengthscales.
    known_ratio: float = Field(default=0.75, gt=0)
    # Samples for choosing the hyperparameters.
    n_likelihood_samples: int = Field(default=300, ge=8)


class InducingPrior:
    """Lays inducing points over a survey; cost grows with samples times weights squared."""

    is_calibrated = False

    def __init__(self, name: str, kernel: type[Kernel], terms: tuple[Term, ...], config: InducingConfig) -> None:
        self.name, self.kernel, self.terms, self.config = name, kernel, terms, config

    def choose_hyperparameters(self, points: Points, field: Vectors) -> Hyperparameters:
        """Numbers by restricted marginal likelihood, the lengthscale no smaller than the cap on nodes allows."""
        check_samples(points, field, MIN_SAMPLES)
        extent = float(np.linalg.norm(np.ptp(points, axis=0)))
        if float(field.std(axis=0).max()) < SMALLEST_SD or extent == 0:
            # Nothing varies, or nothing can be told from noise: any numbers do, these give flat answers.
            sd = max(float(field.std(axis=0).max()), SMALLEST_SD)
            lengthscale = max(extent / 2, 1.0)
            return self._resolved(points, ScaleFit(lengthscale, sd, sd, 0.0))
        n = self.config.n_likelihood_samples
        # Beyond half the extent a field cannot be told from a gradient or two.
        bounds = extent / 100, extent / 2
        fit = fit_lengthscale(self._unit_kernel, points, field, bounds, n)
        grid = self._grid(points, self.config.spacing_ratio * fit.scale, None)
        affordable = grid.spacing / self.config.spacing_ratio
        if affordable > fit.scale * (1 + 1e-9):
            log.warning(
                "lengthscale %.3g m instead of %.3g m: %d inducing points cannot cover the survey more finely",
                affordable, fit.scale, self.config.max_inducing_points,
            )  # fmt: skip
            rows = choose_samples(points, field, n)
            fit = fit_at(self._unit_kernel(affordable), points[rows], field[rows])
        return self._resolved(points, fit)

    def is_affordable(self, points: Points, field: Vectors) -> bool:
        """Whether the inducing points allowed follow the field's typical length."""
        length = typical_length(points, field)
        if len(points) > MOST_SAMPLES or length == 0:
            return False
        wished = self.config.spacing_ratio * length
        return self._grid(points, wished, None).spacing <= _AFFORDABLE_WIDENING * wished

    def build(self, points: Points, field: Vectors, hyperparameters: Hyperparameters) -> InducingModel:
        """Lay inducing points over the surroundings of the points."""
        check_samples(points, field, MIN_SAMPLES)
        h, config = hyperparameters, self.config
        grid = self._grid(points, max(h.spacing, config.min_spacing_ratio * h.lengthscale), h.lengthscale)
        if grid.spacing > 1.5 * h.lengthscale:
            log.warning(
                "inducing points %.3g m apart for a lengthscale of %.3g m: the field between them is lost",
                grid.spacing, h.lengthscale,
            )  # fmt: skip
        basis, constant_sd = GaussianGrid(grid, h.lengthscale, self.terms), config.constant_sd
        return InducingModel(
            replace(h, spacing=grid.spacing), basis, self._unit_kernel(h.lengthscale), constant_sd,
            dense_prior(basis.gram(), h, constant_sd, config.jitter), cKDTree(points),
            config.known_ratio * h.lengthscale,
        )  # fmt: skip

    def _grid(self, points: Points, spacing: float, lengthscale: float | None) -> InducingGrid:
        """Inducing points for a lengthscale, or for one in proportion to the spacing."""
        config = self.config

        def reach_at(h: float) -> float:
            return config.reach_ratio * (h / config.spacing_ratio if lengthscale is None else lengthscale)

        return lay_affordable_grid(points, spacing, reach_at, config.max_inducing_points)

    def _resolved(self, points: Points, fit: ScaleFit) -> Hyperparameters:
        """Numbers of a fit, with the spacing that the cap on nodes allows."""
        grid = self._grid(points, self.config.spacing_ratio * fit.scale, fit.scale)
        return Hyperparameters(fit.scale, fit.signal_sd, fit.noise_sd, grid.spacing)

    def _unit_kernel(self, lengthscale: float) -> Kernel:
        return self.kernel(lengthscale, 1.0)
