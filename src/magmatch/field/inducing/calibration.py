# SPDX-License-Identifier: BSD-3-Clause
"""Calibration of a model's noise and spread on held-out samples."""

from collections.abc import Callable
from dataclasses import replace

import numpy as np
from scipy.spatial import cKDTree

from magmatch.field.folds import COVERAGE, IN_SDS, Folds, divide
from magmatch.field.hyperparameters import Hyperparameters
from magmatch.field.inducing.marginal_likelihood import choose_samples
from magmatch.field.linear_model import FieldPosterior, LinearModel, Prior
from magmatch.typing import Indices, Mask, Points, Scalars, Vectors

# A field that varies less is taken as constant: well below the rounding of any recording, T.
SMALLEST_SD = 1e-12
# Samples that are used, all folds together.
_N_USED = 2000
# Samples of one fold at which the covariance is computed.
_N_COMPARED = 400
# Factors tried on the posterior's standard deviation.
_INFLATIONS = np.geomspace(1.0, 8.0, 19)
# Standard errors by which neighbours' residuals must be alike to count as misfit.
_LEAST_T = 2.0


def calibrated(
    prior: Prior, points: Points, field: Vectors, h: Hyperparameters, model: LinearModel | None = None
) -> Hyperparameters:
    """Calibrate noise and spread on held-out samples; neither becomes smaller.

    ``model``: the prior's model for the same arguments, if available.
    """
    if prior.is_calibrated or float(field.std(axis=0).max()) < SMALLEST_SD:
        return h
    some = np.sort(choose_samples(points, field, _N_USED))
    few, values = points[some], field[some]
    folds = divide(few, h.lengthscale)
    if not folds.left_out:
        return h
    model = prior.build(points, field, h) if model is None else model
    everything = model.observe(few, values)

    def without(fold: Mask) -> FieldPosterior:
        return model.infer(everything - model.observe(few[fold], values[fold]))

    honest = widened(h, few, values, folds, without)
    # Along a path neighbours share errors of their poses too.
    least = 1.0 if folds.is_path else misfit_inflation(few, values, model.infer(everything))
    return replace(honest, inflation=max(honest.inflation, least))


def misfit_inflation(points: Points, field: Vectors, posterior: FieldPosterior) -> float:
    """Factor on a posterior's standard deviation that accounts for what the model cannot represent.

    Noise is independent between samples: a correlation between residuals of nearest neighbours is misfit, such as
    that of a source which the prior rules out. Unlike noise, misfit does not average out over many samples.
    """
    rows = np.arange(len(points))
    residual = field - posterior.evaluate(points).field
    nearest = np.asarray(cKDTree(points).query(points, k=2)[1])
    # Of samples at one place either may stand first.
    other = np.where(nearest[:, 0] == rows, nearest[:, 1], nearest[:, 0])
    shared = (residual * residual[other]).mean(axis=1)
    if not shared.mean() > _LEAST_T * shared.std() / np.sqrt(len(rows)):
        return 1.0
    covariance = posterior.covariance(points[_some(np.ones(len(rows), dtype=np.bool_))])
    variance = np.trace(covariance, axis1=1, axis2=2).mean() / 3 / posterior.hyperparameters.inflation**2
    return float(np.sqrt(1.0 + shared.mean() / variance))


def widened(
    h: Hyperparameters, points: Points, field: Vectors, folds: Folds, fit_without: Callable[[Mask], FieldPosterior]
) -> Hyperparameters:
    """Widen noise and spread as held-out samples ask; neither becomes smaller.

    The mean does not change: noise and prior grow by the same factor. Of a few spreads, the sharpest in mean log
    width that covers 95 % of all held-out components is chosen.
    """
    sizes, variances = [], []
    for fold in folds.left_out:
        posterior, rows = fit_without(fold), _some(fold)
        sizes.append(np.abs(posterior.evaluate(points[rows]).field - field[rows]))
        covariance = posterior.covariance(points[rows])
        variances.append(np.diagonal(covariance, axis1=1, axis2=2) / (h.inflation * h.noise_sd) ** 2)
    growth, inflation = _sharpest(np.concatenate(sizes) / h.noise_sd, np.concatenate(variances))
    return replace(h, noise_sd=growth * h.noise_sd, prior_scale=growth * h.prior_scale, inflation=inflation)


def _sharpest(size: Scalars, variance: Scalars) -> tuple[float, float]:
    """Factor on the noise (at least 1) and on the posterior's sd that cover held-out components most sharply."""
    best = (np.inf, 1.0, 1.0)
    for inflation in _INFLATIONS:
        width = np.sqrt(1.0 + inflation**2 * variance)
        growth = max(float(np.quantile(size / width, COVERAGE)) / IN_SDS, 1.0)
        best = min(best, (float(np.log(growth) + np.log(width).mean()), growth, float(inflation)))
    return best[1], best[2]


def _some(fold: Mask) -> Indices:
    """Rows of a fold, thinned."""
    rows = np.flatnonzero(fold)
    return np.asarray(rows[:: -(-len(rows) // _N_COMPARED)], dtype=np.int64)
