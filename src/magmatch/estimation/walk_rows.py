# SPDX-License-Identifier: BSD-3-Clause
"""Rows of the least squares of a walk's poses, and how correlated residuals are whitened."""

import numpy as np
from scipy.linalg.lapack import dtrtrs

from magmatch.geometry import skew
from magmatch.typing import Mask, Matrix, Points, Tensors


def residual_rows(
    R: Tensors, y: np.ndarray, b: np.ndarray, values: tuple[Points, Tensors], known: Mask, strain: Matrix
) -> tuple[np.ndarray, np.ndarray]:
    """Residuals of h poses of n bins, with slopes; and slopes of the field with where the bins are.

    ``R`` (h, 3, 3) turns the walk's axes to the base's; ``y`` and ``b`` (h, n, 3), m and T, are bins about the walk's
    centre and their field, walk's axes; ``values`` (h n, 3) and (h n, 3, 3), T and T/m, the map's field and gradient
    there, base model axes. Rows are 0 where the map is not ``known`` (h, n), else divided by the ``strain`` (h, n).

    Rows (h, n, 3, 7) are the residual ``b - R^T B``, T, and its slopes ``[G [y]x - [b]x, -G]``, G the gradient in the
    walk's axes; slopes (h, n, 3, 6) are ``[[b]x, G]``: what a turn and a shift of each bin do to its residual.
    """
    field, gradient = (x.reshape(*known.shape, *x.shape[1:]) for x in values)
    is_told, turned = known[..., None, None], skew(b)
    gradient = np.where(is_told, np.swapaxes(R, 1, 2)[:, None] @ gradient @ R[:, None], 0.0)
    rows = np.concatenate([(b - field @ R)[..., None], gradient @ skew(y) - turned, -gradient], axis=3)
    return np.where(is_told, rows / strain[..., None, None], 0.0), np.concatenate([turned, gradient], axis=3)


def whiten(L: Matrix, rows: Matrix, *, again: bool = False) -> Matrix:
    """Give ``L^-1 rows``, or again ``L^-T rows``, of rows (h, n) or (h, n, k), L lower triangular (h, n, n)."""
    # LAPACK itself: of small matrices, SciPy's checks take longer. It reads them by columns: transposed.
    pairs = zip(L, rows, strict=True)
    return np.stack([dtrtrs(one.T, of, lower=0, trans=int(not again))[0] for one, of in pairs])


def isolate(C: Matrix, known: Mask) -> Matrix:
    """Cut unknown bins off: unit variance, no covariance, so that they add nothing to any sum or determinant."""
    known = np.repeat(known, C.shape[1] // known.shape[1], axis=1)
    return np.where(known[:, :, None] & known[:, None], C, np.eye(C.shape[1]))
