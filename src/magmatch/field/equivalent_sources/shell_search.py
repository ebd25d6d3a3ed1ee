# SPDX-License-Identifier: BSD-3-Clause
"""Signal, noise and score of a layer of equivalent sources: by evidence, or on a path by held-out stretches.

Along a path neighbouring samples share their errors, which the evidence mistakes for field: there, held-out stretches
decide.
"""

import numpy as np
from scipy.linalg import LinAlgError, cho_factor, cho_solve

from magmatch.field.equivalent_sources.shell import SourceShell
from magmatch.field.folds import Folds
from magmatch.field.inducing.marginal_likelihood import ScaleFit, tridiagonal, tridiagonal_score
from magmatch.typing import Mask, Matrix, Points, Scalars, Vectors

# Noise over signal, both as variances.
_NOISE_RATIOS = np.geomspace(1e-7, 10.0, 33)
_FEW_NOISE_RATIOS = np.geomspace(1e-5, 0.3, 7)
# Constant field over signal, as standard deviations: next to free.
_CONSTANT = 100.0
# Held-out stretches that nothing else comes near miss by as much as the field varies: a low power of the residuals
# keeps them from drowning the others.
_PATH_POWER = 0.5


def fit_shell(shell: SourceShell, points: Points, field: Vectors, folds: Folds) -> ScaleFit:
    """Signal and noise that suit one layer of sources best."""
    unit = float(np.abs(field - field.mean(axis=0)).max())
    y = ((field - field.mean(axis=0)) / unit).T.ravel()
    A = _design(shell, points)
    gram, r = A.T @ A, A.T @ y
    if folds.is_path and folds.left_out:
        ratio, score = _by_stretches(A, y, gram, r, folds)
    else:
        ratio, score = _by_evidence(gram, r, y)
    w = _solve(gram, r, ratio)
    variance = max(float(y @ y - r @ w) / len(y), np.finfo(float).tiny)
    noise_sd = unit * float(np.sqrt(variance))
    return ScaleFit(shell.distance, noise_sd / float(np.sqrt(ratio)), noise_sd, score)


def _by_evidence(gram: Matrix, r: Scalars, y: Scalars) -> tuple[float, float]:
    """Noise ratio of the highest marginal likelihood, with that likelihood.

    With ``A^T A = Q T Q^T`` the n-dimensional Gaussian needs only the small tridiagonal T: its determinant is that of
    ``I + T / ratio``, its quadratic form ``y'y - z'(T + ratio I)^-1 z``, ``z = Q^T A^T y``.
    """
    diagonal, off_diagonal, z = tridiagonal(gram, r)
    n, m = len(y), len(r)
    best = (-np.inf, 1.0)
    for ratio in _NOISE_RATIOS:
        log_determinant, quadratic = tridiagonal_score(diagonal + ratio, off_diagonal, z)
        left = float(y @ y) - quadratic
        if not left > 0:
            continue
        score = -0.5 * (n * np.log(left / n) + log_determinant - m * np.log(ratio))
        best = max(best, (float(score), float(ratio)))
    return best[1], best[0]


def _by_stretches(A: Matrix, y: Scalars, gram: Matrix, r: Scalars, folds: Folds) -> tuple[float, float]:
    """Noise ratio of the smallest held-out error, with minus its logarithm."""
    errors = np.zeros(len(_FEW_NOISE_RATIOS))
    for fold in folds.left_out:
        rows = np.tile(fold, 3)
        out = A[rows]
        kept_gram, kept_r = gram - out.T @ out, r - out.T @ y[rows]
        for k, ratio in enumerate(_FEW_NOISE_RATIOS):
            errors[k] += _power_sum(out @ _solve(kept_gram, kept_r, ratio) - y[rows], fold)
    best = int(np.argmin(errors))
    return float(_FEW_NOISE_RATIOS[best]), -float(np.log(errors[best])) / _PATH_POWER


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
