# SPDX-License-Identifier: BSD-3-Clause
"""Fields without sources in the region: equivalent charges on a layer around it, plus a constant field."""

import logging
from dataclasses import replace

import numpy as np
from pydantic import Field
from scipy.spatial import cKDTree

from magmatch.field.domain import Box
from magmatch.field.equivalent_sources.inner_sources import InnerSources, find_inner_sources
from magmatch.field.equivalent_sources.shell import SourceShell, lay_shell
from magmatch.field.equivalent_sources.shell_search import fit_shell
from magmatch.field.folds import divide
from magmatch.field.hyperparameters import Hyperparameters
from magmatch.field.inducing.calibration import SMALLEST_SD
from magmatch.field.inducing.inducing_model import InducingModel, independent_prior
from magmatch.field.inducing.inducing_prior import MIN_SAMPLES, MOST_SAMPLES
from magmatch.field.inducing.kernels import CurlFreeKernel
from magmatch.field.inducing.marginal_likelihood import ScaleFit, walk_uphill
from magmatch.field.linear_model import check_samples
from magmatch.field.variogram import typical_length
from magmatch.settings import Settings
from magmatch.typing import Points, Vectors

log = logging.getLogger(__name__)

# A layer so much farther out than was asked for is the nearest there is; one so little farther is the same.
_SAME_DISTANCE = 1.01
# Inner sources are found by the noise and signal that a first layer left, then by what is left with them.
_ROUNDS_OF_SOURCES = 2
# The search of the distance: its first factor, how many steps, and the factor below which it ends.
_STEP, _MOST_STEPS, _FINEST_STEP = float(np.sqrt(2)), 8, 1.3


class HarmonicConfig(Settings):
    """Settings of the equivalent sources."""

    # Spacing of the charges over their distance from the samples; denser gained nothing (docs/tried.md).
    spacing_ratio: float = Field(default=0.5, gt=0)
    # Most charges; more moves the layer out and the charges apart.
    max_sources: int = Field(default=2000, ge=8)
    # The same while the distance is searched.
    max_search_sources: int = Field(default=1500, ge=8)
    # Prior standard deviation of the constant field, T: broad against the Earth's 25 to 65 uT.
    constant_sd: float = Field(default=1e-4, ge=0)
    # Distance from a sample within which the field counts as known, in distances of the layer.
    known_ratio: float = Field(default=0.6, gt=0)
    # Samples for choosing the distance and the noise.
    n_search_samples: int = Field(default=4000, ge=8)


class HarmonicPrior:
    """Curl-free and divergence-free exactly; right only where no source stands in the region that is asked for."""

    name, is_calibrated = "harmonic", False

    def __init__(self, config: HarmonicConfig | None = None, box: Box | None = None) -> None:
        # A box that is declared holds no sources, wherever the samples are.
        self.config, self.box = config or HarmonicConfig(), box

    def choose_hyperparameters(self, points: Points, field: Vectors) -> Hyperparameters:
        """Distance of the layer, signal and noise from the data."""
        check_samples(points, field, MIN_SAMPLES)
        ratio = self.config.spacing_ratio
        length = typical_length(points, field)
        sd = float(field.std(axis=0).max())
        if sd < SMALLEST_SD or length == 0:
            distance = max(float(np.linalg.norm(np.ptp(points, axis=0))) / 2, 1.0)
            sd = max(sd, SMALLEST_SD)
            return Hyperparameters(distance, sd, sd, ratio * distance)
        some = self._some(points)
        fit = self._search(points, field, some, length)
        h = Hyperparameters(fit.scale, fit.signal_sd, fit.noise_sd, ratio * fit.scale)
        return h if self.box is not None else self._with_sources(points, field, h)

    def is_affordable(self, points: Points, field: Vectors) -> bool:
        """Whether the charges allowed can stand as near as the field's typical length asks for."""
        length = typical_length(points, field)
        if len(points) > MOST_SAMPLES or length == 0:
            return False
        ratio = self.config.spacing_ratio
        shell = lay_shell(points, length / 2, ratio * length / 2, self.config.max_sources)
        return shell.distance <= length

    def build(self, points: Points, field: Vectors, hyperparameters: Hyperparameters) -> InducingModel:
        """Lay charges around the points and the box."""
        check_samples(points, field, MIN_SAMPLES)
        h = hyperparameters
        if self.box is None:
            shell = self._sources(points, field, h).filled(h, self.config.constant_sd)
        else:
            shell = self._shell(points, h.lengthscale, h.spacing, self.config.max_sources)
        if shell.distance > _SAME_DISTANCE * h.lengthscale:
            log.warning(
                "equivalent sources %.3g m from the samples, not %.3g m: at most %d allowed",
                shell.distance, h.lengthscale, self.config.max_sources,
            )  # fmt: skip
        constant_sd = self.config.constant_sd
        return InducingModel(
            h, shell, CurlFreeKernel(shell.distance, 1.0), constant_sd,
            independent_prior(shell.n_weights, h, constant_sd), cKDTree(points),
            self.config.known_ratio * shell.distance, shell.inner,
        )  # fmt: skip

    def _shell(self, points: Points, distance: float, spacing: float, most: int) -> SourceShell:
        """Layer around the points and the box."""
        if self.box is None:
            return lay_shell(points, distance, spacing, most)
        # The lattice stands for the box: charges must not fit between its points.
        step = self.box.lattice_step(distance / 2)
        farther = max(2 * step, distance)
        region = np.concatenate([points, self.box.lattice(step)])
        return lay_shell(region, farther, spacing * farther / distance, most)

    def _sources(self, points: Points, field: Vectors, h: Hyperparameters) -> InnerSources:
        """Find the places where the data may show sources nearer than the layer."""
        some = self._some(points)
        shell = lay_shell(points, h.lengthscale, h.spacing, self.config.max_sources)
        return find_inner_sources(shell, points[some], field[some])

    def _with_sources(self, points: Points, field: Vectors, h: Hyperparameters) -> Hyperparameters:
        """Signal and noise once inner sources are no longer noise; with less of it more of them show."""
        some, found = self._some(points), self._sources(points, field, h)
        for _ in range(_ROUNDS_OF_SOURCES):
            shell = found.filled(h, self.config.constant_sd)
            if shell.inner is None:
                break
            fit = fit_shell(shell, points[some], field[some], divide(points[some], h.lengthscale))
            h = replace(h, signal_sd=fit.signal_sd, noise_sd=fit.noise_sd)
        return h

    def _some(self, points: Points) -> slice:
        """Samples that numbers are chosen on."""
        return slice(None, None, -(-len(points) // self.config.n_search_samples))

    def _search(self, points: Points, field: Vectors, some: slice, length: float) -> ScaleFit:
        """Best distance; where one takes too many charges, the nearest that can be afforded stands for it."""
        ratio, most = self.config.spacing_ratio, self.config.max_search_sources
        extent = float(np.linalg.norm(np.ptp(points, axis=0)))
        folds = divide(points[some], length)
        nearest: list[ScaleFit] = []

        def fit_at(distance: float) -> ScaleFit:
            if nearest and distance < _SAME_DISTANCE * nearest[0].scale:
                return nearest[0]
            shell = self._shell(points, distance, ratio * distance, most)
            fit = fit_shell(shell, points[some], field[some], folds)
            if shell.distance > _SAME_DISTANCE * distance:
                nearest.append(fit)
            return fit

        return walk_uphill(fit_at, length / 2, (length / 10, extent / 2), _STEP, _MOST_STEPS, _FINEST_STEP)
