# SPDX-License-Identifier: BSD-3-Clause
"""Fields without sources in the region: equivalent charges on a layer around it, plus a constant field.

The layer's distance, signal and noise are found by evidence. Along a path neighbouring samples share their errors,
which the evidence mistakes for field: there, held-out stretches decide.
"""

import logging
from dataclasses import replace

import numpy as np
from scipy.linalg import LinAlgError, cho_factor, cho_solve
from scipy.spatial import cKDTree

from magmatch.field.domain import Box
from magmatch.field.equivalent_sources.inner_sources import InnerSources, find_inner_sources
from magmatch.field.equivalent_sources.shell import SourceShell, lay_shell
from magmatch.field.excess import WIDEST
from magmatch.field.folds import Folds, divide
from magmatch.field.hyperparameters import Hyperparameters
from magmatch.field.inducing.calibration import SMALLEST_SD
from magmatch.field.inducing.inducing_model import InducingModel
from magmatch.field.inducing.inducing_prior import MIN_SAMPLES, MOST_SAMPLES
from magmatch.field.inducing.kernels import CURL_FREE, Kernel
from magmatch.field.inducing.marginal_likelihood import ScaleFit, tridiagonal, tridiagonal_score, walk_uphill
from magmatch.field.linear_model import check_samples
from magmatch.field.spline.spline_prior import CONSTANT_SD
from magmatch.field.variogram import typical_length
from magmatch.typing import Mask, Matrix, Points, Scalars, Vectors

log = logging.getLogger(__name__)

# A layer so much farther out than was asked for is the nearest there is; one so little farther is the same.
_SAME_DISTANCE = 1.01
# Inner sources are found by the noise and signal that a first layer left, then by what is left with them.
_ROUNDS_OF_SOURCES = 2
# The search of the distance: its first factor, how many steps, and the factor below which it ends.
_STEP, _MOST_STEPS, _FINEST_STEP = float(np.sqrt(2)), 8, 1.3
# Spacing of the charges over their distance from the samples; denser gained nothing (docs/tried.md).
SPACING_RATIO = 0.5
# Most charges, and the same while the distance is searched; more moves the layer out and the charges apart.
MAX_SOURCES, _MAX_SEARCH_SOURCES = 2000, 1500
# Distance from a sample within which the field counts as known, in distances of the layer.
_KNOWN_RATIO = 0.6
# Samples for choosing the distance and the noise.
_N_SEARCH_SAMPLES = 4000
# Noise over signal, both as variances.
_NOISE_RATIOS = np.geomspace(1e-7, 10.0, 33)
_FEW_NOISE_RATIOS = np.geomspace(1e-5, 0.3, 7)
# Constant field over signal, as standard deviations: next to free.
_CONSTANT = 100.0
# Held-out stretches that nothing else comes near miss by as much as the field varies: a low power of the residuals
# keeps them from drowning the others.
_PATH_POWER = 0.5


class HarmonicPrior:
    """Curl-free and divergence-free exactly; right only where no source stands in the region that is asked for."""

    name, is_calibrated = "harmonic", False

    def __init__(self, box: Box | None = None, max_sources: int = MAX_SOURCES) -> None:
        # A box that is declared holds no sources, wherever the samples are.
        self.box, self.max_sources = box, max_sources

    def choose_hyperparameters(self, points: Points, field: Vectors) -> Hyperparameters:
        """Distance of the layer, signal and noise from the data."""
        check_samples(points, field, MIN_SAMPLES)
        length = typical_length(points, field)
        sd = float(field.std(axis=0).max())
        if sd < SMALLEST_SD or length == 0:
            distance = max(float(np.linalg.norm(np.ptp(points, axis=0))) / 2, 1.0)
            sd = max(sd, SMALLEST_SD)
            return Hyperparameters(distance, sd, sd, SPACING_RATIO * distance)
        some = self._some(points)
        fit = self._search(points, field, some, length)
        h = Hyperparameters(fit.scale, fit.signal_sd, fit.noise_sd, SPACING_RATIO * fit.scale)
        return h if self.box is not None else self._with_sources(points, field, h)

    def is_affordable(self, points: Points, length: float) -> bool:
        """Whether the charges allowed can stand as near as a field's typical length (m) asks for."""
        if len(points) > MOST_SAMPLES or length == 0:
            return False
        shell = lay_shell(points, length / 2, SPACING_RATIO * length / 2, self.max_sources, farthest=length)
        return shell.distance <= length

    def build(self, points: Points, field: Vectors, hyperparameters: Hyperparameters) -> InducingModel:
        """Lay charges around the points and the box."""
        check_samples(points, field, MIN_SAMPLES)
        h = hyperparameters
        if self.box is None:
            shell = self._sources(points, field, h).filled(h)
        else:
            shell = self._shell(points, h.lengthscale, h.spacing, self.max_sources)
        if shell.distance > _SAME_DISTANCE * h.lengthscale:
            log.warning(
                "equivalent sources %.3g m from the samples, not %.3g m: at most %d allowed",
                shell.distance, h.lengthscale, self.max_sources,
            )  # fmt: skip
        # The weights are independent.
        factor = np.full(shell.n_weights + 3, h.noise_sd / (h.prior_scale * h.signal_sd))
        factor[-3:] = h.noise_sd / CONSTANT_SD
        return InducingModel(
            h, shell, Kernel(CURL_FREE, shell.distance), CONSTANT_SD, factor, cKDTree(points),
            _KNOWN_RATIO * shell.distance, shell.inner,
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
        shell = lay_shell(points, h.lengthscale, h.spacing, self.max_sources)
        return find_inner_sources(shell, points[some], field[some])

    def _with_sources(self, points: Points, field: Vectors, h: Hyperparameters) -> Hyperparameters:
        """Signal and noise once inner sources are no longer noise; with less of it more of them show."""
        some, found = self._some(points), self._sources(points, field, h)
        for _ in range(_ROUNDS_OF_SOURCES):
            shell = found.filled(h)
            if shell.inner is None:
                break
            fit = fit_shell(shell, points[some], field[some], divide(points[some], h.lengthscale))
            h = replace(h, signal_sd=fit.signal_sd, noise_sd=fit.noise_sd)
        return h

    def _some(self, points: Points) -> slice:
        """Samples that numbers are chosen on."""
        return slice(None, None, -(-len(points) // _N_SEARCH_SAMPLES))

    def _search(self, points: Points, field: Vectors, some: slice, length: float) -> ScaleFit:
        """Best distance; where one takes too many charges, the nearest that can be afforded stands for it."""
        most = min(self.max_sources, _MAX_SEARCH_SOURCES)
        extent = float(np.linalg.norm(np.ptp(points, axis=0)))
        folds = divide(points[some], length)
        nearest: list[ScaleFit] = []

        def fit_at(distance: float) -> ScaleFit:
            if nearest and distance < _SAME_DISTANCE * nearest[0].scale:
                return nearest[0]
            shell = self._shell(points, distance, SPACING_RATIO * distance, most)
            fit = fit_shell(shell, points[some], field[some], folds)
            if shell.distance > _SAME_DISTANCE * distance:
                nearest.append(fit)
            return fit

        return walk_uphill(fit_at, length / 2, (length / 10, extent / 2), _STEP, _MOST_STEPS, _FINEST_STEP)


def fit_shell(shell: SourceShell, points: Points, field: Vectors, folds: Folds) -> ScaleFit:
    """Signal and noise that suit one layer of sources best.

    By the prior the field at the samples varies at most `WIDEST` times as much as it does: else a far layer fits what
    is rough by huge charges that cancel where there are samples, and only there.
    """
    unit = float(np.abs(field - field.mean(axis=0)).max())
    y = ((field - field.mean(axis=0)) / unit).T.ravel()
    A = _design(shell, points)
    gram, r = A.T @ A, A.T @ y
    is_path = folds.is_path and bool(folds.left_out)
    scored = _by_stretches(A, y, gram, r, folds) if is_path else _by_evidence(gram, r, y)
    widest = WIDEST * unit * float(np.sqrt(y @ y / len(y) / _variance(shell, A, gram)))
    for score, ratio in sorted(scored, reverse=True):
        w = _solve(gram, r, ratio)
        variance = max(float(y @ y - r @ w) / len(y), np.finfo(float).tiny)
        noise_sd = unit * float(np.sqrt(variance))
        fit = ScaleFit(shell.distance, noise_sd / float(np.sqrt(ratio)), noise_sd, score)
        if fit.signal_sd <= widest:
            break
    return fit


def _variance(shell: SourceShell, A: Matrix, gram: Matrix) -> float:
    """How much a component of the layer's field varies at samples for unit signal; the constant takes its mean."""
    layer = shell.n_weights - (0 if shell.inner is None else shell.inner.n)
    mean = A.reshape(3, -1, A.shape[1]).mean(axis=1)[:, :layer]
    return float(np.trace(gram[:layer, :layer]) / len(A) - (mean**2).sum() / 3)


def _by_evidence(gram: Matrix, r: Scalars, y: Scalars) -> list[tuple[float, float]]:
    """Marginal likelihoods, each with its noise ratio.

    With ``A^T A = Q T Q^T`` the n-dimensional Gaussian needs only the small tridiagonal T: its determinant is that of
    ``I + T / ratio``, its quadratic form ``y'y - z'(T + ratio I)^-1 z``, ``z = Q^T A^T y``.
    """
    diagonal, off_diagonal, z = tridiagonal(gram, r)
    n, m = len(y), len(r)
    scored = []
    for ratio in _NOISE_RATIOS:
        log_determinant, quadratic = tridiagonal_score(diagonal + ratio, off_diagonal, z)
        left = float(y @ y) - quadratic
        if not left > 0:
            continue
        score = -0.5 * (n * np.log(left / n) + log_determinant - m * np.log(ratio))
        scored.append((float(score), float(ratio)))
    return scored or [(-np.inf, 1.0)]


def _by_stretches(A: Matrix, y: Scalars, gram: Matrix, r: Scalars, folds: Folds) -> list[tuple[float, float]]:
    """Minus the logarithms of held-out errors, each with its noise ratio."""
    errors = np.zeros(len(_FEW_NOISE_RATIOS))
    for fold in folds.left_out:
        rows = np.tile(fold, 3)
        out = A[rows]
        kept_gram, kept_r = gram - out.T @ out, r - out.T @ y[rows]
        for k, ratio in enumerate(_FEW_NOISE_RATIOS):
            errors[k] += _power_sum(out @ _solve(kept_gram, kept_r, ratio) - y[rows], fold)
    return [(-float(np.log(e)) / _PATH_POWER, float(k)) for e, k in zip(errors, _FEW_NOISE_RATIOS, strict=True)]


def _power_sum(residual: Scalars, fold: Mask) -> float:
    square = (residual.reshape(3, fold.sum()) ** 2).sum(axis=0)
    return float((square ** (_PATH_POWER / 2)).mean())


def _solve(gram: Matrix, r: Scalars, ratio: float) -> Scalars:
    loaded = gram.copy()
    loaded[np.diag_indices_from(loaded)] += ratio
    try:
        return np.asarray(cho_solve(cho_factor(loaded, lower=True, overwrite_a=True), r))
    except LinAlgError:
        return np.zeros(len(r))


def _design(shell: SourceShell, points: Points) -> Matrix:
    """Field per unit of each weight, the constant's columns large: (3 n, m + 3)."""
    n = len(points)
    return np.hstack([shell.design(points), np.kron(_CONSTANT * np.eye(3), np.ones((n, 1)))])
