# SPDX-License-Identifier: BSD-3-Clause
"""Keypoints: where the magnitude of the field curves strongly and the map is accurate."""

import numpy as np

from magmatch.features.config import FeatureConfig
from magmatch.features.grids import InferencePoints
from magmatch.field.map import FieldMap
from magmatch.field.values import FieldValues
from magmatch.geometry import transform_points
from magmatch.typing import Indices, Scalars, Tensors

# The strongest responses, of either sign, make the mean; of each of this share of the points the map is asked whether
# it knows more of the field than its prior: at least by half the standard deviation.
_DECISIVE, _KNOWN = 0.2, 0.5
# Responses beyond what this share stays below are counted as no more than that.
_CLIPPED_TO = 0.99


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
    hessian: Tensors = (
        np.swapaxes(G, 1, 2) @ G / n
        - along[:, :, None] * along[:, None, :] / n**3
        + np.einsum("na,naij->nij", B, values.second) / n
    )
    return hessian


def curvature_response(values: FieldValues) -> Scalars:
    """Determinant of the Hessian of the magnitude: positive at minima and at half of the saddles, as published."""
    H = magnitude_hessian(values)
    # Written out: LAPACK's determinant warns about NaN.
    doh: Scalars = np.einsum("ni,ni->n", H[:, 0], np.cross(H[:, 1], H[:, 2]))
    return doh


def find_keypoints(field_map: FieldMap, points: InferencePoints, response: Scalars, config: FeatureConfig) -> Indices:
    """Points of X* with more than the mean response whose field is known well."""
    if not np.isfinite(response).any():
        return np.zeros(0, dtype=np.int64)
    rows = np.flatnonzero(response > threshold(field_map, points, response)).astype(np.int64)
    if not len(rows):
        return rows
    variance = block_variance(field_map, points, rows)
    # A hair of slack, so that equal variances do not part by rounding.
    limit = np.quantile(variance, config.variance_quantile) * (1 + 1e-9)
    kept: Indices = rows[variance <= limit]
    return kept


def threshold(field_map: FieldMap, points: InferencePoints, response: Scalars) -> float:
    """Mean response, over what the samples tell: that where the map gives its prior is a basis running out.

    The response is a product of three curvatures, hence a few points decide its mean. Where few negative ones
    outweigh all others, the mean tells nothing: then it is that of clipped responses, and never negative.
    """
    size = np.abs(response)
    rows = np.flatnonzero(size >= np.nanquantile(size, 1 - _DECISIVE)).astype(np.int64)
    limit = (_KNOWN * field_map.hyperparameters.signal_sd) ** 2
    told = np.delete(response, rows[block_variance(field_map, points, rows) > limit])
    if not np.isfinite(told).any():
        return 0.0
    largest = np.nanquantile(np.abs(told), _CLIPPED_TO)
    return float(max(np.nanmean(told), np.nanmean(np.clip(told, -largest, largest)), 0.0))


def block_variance(field_map: FieldMap, points: InferencePoints, rows: Indices) -> Scalars:
    """Mean posterior variance of the components of the field around chosen points, T^2.

    Asked once for each block of 2 x 2 x 2 grid points, at its centre: variance changes slowly, and a dense posterior
    spends more on it than on all the rest.
    """
    ijk = np.stack(np.unravel_index(points.cells[rows], points.grid.shape), axis=1)
    blocks, block_of_row = np.unique(ijk // 2, axis=0, return_inverse=True)
    centers = transform_points((2 * blocks + 0.5) * points.grid.spacing, points.grid.T_map_grid)
    variance = np.trace(field_map.covariance(centers), axis1=1, axis2=2) / 3
    of_rows: Scalars = variance[block_of_row.reshape(-1)]
    return of_rows
