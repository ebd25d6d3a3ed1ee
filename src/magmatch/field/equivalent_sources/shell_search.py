# SPDX-License-Identifier: BSD-3-Clause
"""Signal, noise and score of a layer of equivalent sources: by evidence, or on a path by held-out stretches.

Along a path neighbouring samples share their errors, which the evidence mistakes for field: there, held-out stretches
decide.
"""

import numpy as np
from scipy.linalg import LinAlgError, cho_factor, cho_solve

from magmatch.field.equivalent_sources.shell import SourceShell
from magmatch.field.excess import WIDEST
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
