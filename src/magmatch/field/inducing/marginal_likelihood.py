# SPDX-License-Identifier: BSD-3-Clause
"""Hyperparameters by restricted marginal likelihood: how probable a subset of the samples is, constants aside.

For each lengthscale one tridiagonalisation turns the covariance into ``Q (T + r I) Q^T`` for every noise ratio r at
once, so the scan over r costs next to nothing, and the best signal variance follows in closed form.
"""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from scipy.linalg import lapack
from scipy.spatial import cKDTree

from magmatch.field.inducing.kernels import Kernel
from magmatch.typing import Indices, Mask, Matrix, Points, Scalars, Vectors

# Noise over signal, both as variances: from a thousandth of the signal's amplitude to three times it.
NOISE_RATIOS = np.geomspace(1e-6, 10.0, 43)
# A sample this many times farther from its neighbours' median than they are themselves is not trusted.
_OUTLIER_RATIO = 8.0
_N_NEIGHBOURS = 8
_N_COARSE_SAMPLES = 120
_N_COARSE_LENGTHSCALES = 14
# Uphill from the best of these, on all samples.
_MOST_STEPS = 3


@dataclass(frozen=True, slots=True)
class ScaleFit:
    """The best signal and noise (T, of one component) at one lengthscale or distance (m), and their score.

    The score is the log likelihood up to a constant, or minus the log of a held-out error.
    """

    scale: float
    signal_sd: float
    noise_sd: float
    score: float


def walk_uphill(
    fit_at: Callable[[float], ScaleFit],
    start: float,
    bounds: tuple[float, float],
    step: float,
    most_steps: int,
    least_step: float = 1.0,
) -> ScaleFit:
    """Best of the scales tried: to either side by factors, whose logarithm is halved where neither side is better."""
    fits: dict[float, ScaleFit] = {}

    def fit(scale: float) -> ScaleFit:
        scale = float(np.clip(scale, *bounds))
        if scale not in fits:
            fits[scale] = fit_at(scale)
        return fits[scale]

    center = fit(start).scale
    for _ in range(most_steps):
        best = max((fit(center), fit(center / step), fit(center * step)), key=lambda f: f.score)
        if best.scale == center:
            if step < least_step:
                break
            step **= 0.5
        center = best.scale
    return max(fits.values(), key=lambda f: f.score)


def fit_lengthscale(
    kernel_at: Callable[[float], Kernel],
    points: Points,
    field: Vectors,
    bounds: tuple[float, float],
    n_samples: int,
) -> ScaleFit:
    """Most probable lengthscale, signal and noise; deterministic."""
    rows = choose_samples(points, field, n_samples)
    few = rows[:: max(1, len(rows) // _N_COARSE_SAMPLES)]
    lengthscales = np.geomspace(*bounds, _N_COARSE_LENGTHSCALES)
    coarse = [fit_at(kernel_at(length), points[few], field[few]) for length in lengthscales]
    start, step = max(coarse, key=lambda fit: fit.score).scale, float(lengthscales[1] / lengthscales[0])
    return walk_uphill(
        lambda length: fit_at(kernel_at(length), points[rows], field[rows]), start, bounds, step, _MOST_STEPS
    )


def fit_at(kernel: Kernel, points: Points, field: Vectors) -> ScaleFit:
    """Most probable signal and noise for one kernel of unit signal_sd."""
    unit = float(np.abs(field - field.mean(axis=0)).max())
    y = _contrasts(field / unit if unit > 0 else field).T.ravel()
    n = len(points)
    gram = kernel.covariance(points, points).reshape(3, n, 3, n).transpose(1, 0, 2, 3).reshape(n, -1)
    gram = _contrasts(gram).reshape(n - 1, 3, 3, n).transpose(3, 2, 1, 0).reshape(n, -1)
    gram = _contrasts(gram).reshape(n - 1, 3, 3, n - 1).transpose(1, 0, 2, 3).reshape(3 * n - 3, -1)
    diagonal, off_diagonal, z = tridiagonal(gram, y)
    scores, variances = zip(*(_score(diagonal + r, off_diagonal, z) for r in NOISE_RATIOS), strict=True)
    best = int(np.argmax(scores))
    signal_sd = unit * float(np.sqrt(variances[best]))
    log_likelihood = scores[best] - len(z) * float(np.log(unit)) if unit > 0 else np.inf
    return ScaleFit(kernel.lengthscale, signal_sd, signal_sd * float(np.sqrt(NOISE_RATIOS[best])), log_likelihood)


def choose_samples(points: Points, field: Vectors, n_samples: int) -> Indices:
    """Some samples, spread evenly over the survey's order at random, outliers left out; deterministic."""
    rng = np.random.default_rng(0)
    n = len(points)
    edges = np.linspace(0, n, min(n, n_samples) + 1).astype(np.int64)
    rows = rng.integers(edges[:-1], edges[1:])
    rows = rng.permutation(rows[~_is_outlier(points, field, rows)])
    return rows.astype(np.int64)


def _is_outlier(points: Points, field: Vectors, rows: Indices) -> Mask:
    """Whether some samples disagree with their nearest neighbours far more than those among themselves."""
    k = min(_N_NEIGHBOURS, len(points) - 1)
    if k < 4:
        return np.zeros(len(rows), dtype=np.bool_)
    _, near = cKDTree(points).query(points[rows], k=k + 1)
    around = field[np.asarray(near)[:, 1:]]
    center = np.median(around, axis=1)
    own = np.linalg.norm(field[rows] - center, axis=1)
    theirs = np.median(np.linalg.norm(around - center[:, None], axis=2), axis=1)
    # Where neighbours happen to agree exactly, the survey's typical scatter still counts as agreement.
    return np.asarray(own > _OUTLIER_RATIO * np.maximum(theirs, np.median(theirs)), dtype=np.bool_)


def _contrasts(values: Matrix) -> Matrix:
    """Turn rows so that the first holds their mean (a Householder reflection), and drop it."""
    n = len(values)
    v = np.full(n, 1 / np.sqrt(n))
    v[0] -= 1.0
    if n < 2:
        return values[1:]
    reflected = values - np.outer(v, v @ values) * (2 / (v @ v))
    return np.asarray(reflected[1:])


def tridiagonal(gram: Matrix, y: Scalars) -> tuple[Scalars, Scalars, Scalars]:
    """Diagonal and off-diagonal of T in ``gram = Q T Q^T``, and ``Q^T y``: shifts of the diagonal are then cheap."""
    size = len(gram)
    work, _ = lapack.dsytrd_lwork(size, lower=1)
    reflectors, diagonal, off_diagonal, tau, _ = lapack.dsytrd(
        np.asfortranarray(gram), lower=1, lwork=int(work), overwrite_a=1
    )
    z = y.copy()
    # The reflectors leave the first entry alone; below it they are stored as those of a QR factorisation.
    z[1:] = lapack.dormqr("L", "T", reflectors[1:, :-1], tau, y[1:, None], max(64, size))[0][:, 0]
    return diagonal, off_diagonal, z


def tridiagonal_score(diagonal: Scalars, off_diagonal: Scalars, z: Scalars) -> tuple[float, float]:
    """Log-determinant of a tridiagonal matrix and quadratic form of its inverse; infinite and 0 where indefinite."""
    d, e, info = lapack.dpttrf(diagonal, off_diagonal)
    if info:
        return np.inf, 0.0
    solution, _ = lapack.dpttrs(d, e, z[:, None])
    return float(np.log(d).sum()), float(z @ solution[:, 0])


def _score(diagonal: Scalars, off_diagonal: Scalars, z: Scalars) -> tuple[float, float]:
    """Log-likelihood up to a constant, and the signal variance it takes, for one noise ratio."""
    log_determinant, quadratic = tridiagonal_score(diagonal, off_diagonal, z)
    if np.isinf(log_determinant):
        # This noise ratio is too small to be told from none.
        return -np.inf, 1.0
    variance = max(quadratic / len(z), np.finfo(float).tiny)
    return -0.5 * float(len(z) * np.log(variance) + log_determinant), variance
