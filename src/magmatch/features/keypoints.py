# SPDX-License-Identifier: BSD-3-Clause
"""Keypoints: where the magnitude of the field curves strongly and the map is accurate."""

import numpy as np

from magmatch.features.config import FeatureConfig
from magmatch.features.infer import Inferred
from magmatch.field.values import FieldValues
from magmatch.geometry import transform_points
from magmatch.typing import Indices, Scalars, Tensors


def magnitude_hessian(values: FieldValues) -> Tensors:
    """Second derivatives of the magnitude of the field.

    With n = norm(B) and the derivative d_i along axis i,
    ``d_ij n = (d_i B . d_j B) / n - (B . d_i B)(B . d_j B) / n^3 + (B . d_ij B) / n``; the printed equation has
    ``d_ij |B|`` on its right-hand side too, and an outer product where the second term's numbers stand.
    """
    if values.gradient is None or values.second is None:
        msg = "the Hessian of |B| needs field values of order 2"
        raise ValueError(msg)
    B, G = values.field, values.gradient
    n = np.linalg.norm(B, axis=1)
    n = np.where(n > 0, n, np.nan)[:, None, None]
    along = np.einsum("na,nai->ni", B, G)
    return np.asarray(
        np.swapaxes(G, 1, 2) @ G / n
        - along[:, :, None] * along[:, None, :] / n**3
        + np.einsum("na,naij->nij", B, values.second) / n
    )


def curvature_response(values: FieldValues) -> Scalars:
    """Determinant of the Hessian of the magnitude: positive at minima and at half of the saddles, as published."""
    H = magnitude_hessian(values)
    # Written out: LAPACK's determinant warns about NaN.
    return np.asarray(np.einsum("ni,ni->n", H[:, 0], np.cross(H[:, 1], H[:, 2])))


def detect(inferred: Inferred, config: FeatureConfig | None = None) -> Indices:
    """Find keypoints: points of X* with more than the mean response whose field is known well.

    Parameters
    ----------
    inferred : Inferred
        The field at X*.
    config : FeatureConfig, optional
        Which share of the points above the mean response is kept, those of least variance.

    Returns
    -------
    (k,) array of ints
        Rows of X*, ascending; empty where nothing stands out.
    """
    config = config or FeatureConfig()
    response = curvature_response(inferred.values)
    if not np.isfinite(response).any():
        return np.zeros(0, dtype=np.int64)
    # Minima and half of the saddles have a positive determinant; a mean below 0 would let the others in.
    rows = np.flatnonzero(response > max(float(np.nanmean(response)), 0.0)).astype(np.int64)
    if not len(rows):
        return rows
    variance = block_variance(inferred, rows) if config.max_variance is None else inferred.variance(rows)
    # A hair of slack, so that equal variances do not part by rounding.
    limit = config.max_variance or np.quantile(variance, config.variance_quantile) * (1 + 1e-9)
    return rows[variance <= limit]


def block_variance(inferred: Inferred, rows: Indices) -> Scalars:
    """Mean posterior variance of the components of the field around chosen points, T^2.

    Asked once for each block of 2 x 2 x 2 grid points, at its centre: variance changes slowly, and a dense posterior
    spends more on it than on all the rest.
    """
    grid = inferred.grid
    ijk = np.stack(np.unravel_index(inferred.cells[rows], grid.shape), axis=1)
    blocks, block_of_row = np.unique(ijk // 2, axis=0, return_inverse=True)
    # Centres of blocks that the grid's edge cuts would lie beyond it.
    local = np.minimum(2 * blocks + 0.5, np.array(grid.shape) - 1.0) * grid.spacing
    covariance = inferred.field_map.covariance(transform_points(local, grid.T_map_grid))
    variance = np.trace(covariance, axis1=1, axis2=2) / 3
    return np.asarray(variance[block_of_row.reshape(-1)])
