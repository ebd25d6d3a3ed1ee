# SPDX-License-Identifier: BSD-3-Clause
"""Histograms of Oriented Vectors (HOV): what the field around a keypoint looks like from its local frame."""

import numpy as np

from magmatch.features.infer import Inferred
from magmatch.features.local_frames import CHUNK, LocalFrames
from magmatch.typing import Matrix, Tensors, Vectors

N_AZIMUTH, N_ELEVATION, N_COMPONENT = 20, 10, 20
N_DIMENSIONS = N_AZIMUTH + N_ELEVATION + 3 * N_COMPONENT
# The component range covers this share of the data, so that one strong magnet does not empty the other bins.
RANGE_QUANTILE = 0.98


def describe(inferred: Inferred, frames: LocalFrames, half_range: float | None = None) -> Matrix:
    """Describe the surroundings of each keypoint by Histograms of Oriented Vectors in its local frame.

    Parameters
    ----------
    inferred : Inferred
        The field at X*.
    frames : LocalFrames
        Keypoints.
    half_range : float, T, optional
        Half range of the component histograms; maps to be compared must share it. By default from the map's samples.

    Returns
    -------
    (k, 90) array
        20 shares of azimuth, 10 of elevation, and 20 of each component.
    """
    if half_range is None:
        half_range = component_range(inferred.field_map.survey.field)
    return histograms_of_oriented_vectors(inferred.field, frames.support, frames.axes, half_range)


def component_range(field: Vectors) -> float:
    """Half range of the component histograms, scaled to the data."""
    norm = np.linalg.norm(field, axis=1)
    return max(float(np.quantile(norm, RANGE_QUANTILE)), np.finfo(float).tiny)


def histograms_of_oriented_vectors(
    field: Vectors, neighbours: np.ndarray, frames: Tensors, half_range: float
) -> Matrix:
    """Describe the support vectors of each keypoint in its local frame."""
    descriptors = np.zeros((len(frames), N_DIMENSIONS))
    step = max(CHUNK // max(neighbours.shape[1], 1), 1)
    for start in range(0, len(frames), step):
        part = slice(start, start + step)
        is_there = neighbours[part] >= 0
        local = np.einsum("ksc,kca->ksa", field[neighbours[part]], frames[part])
        azimuth = np.arctan2(local[..., 1], local[..., 0]) / (2 * np.pi) + 0.5
        elevation = np.arctan2(local[..., 2], np.hypot(local[..., 0], local[..., 1])) / np.pi + 0.5
        shares = [
            _histogram(np.minimum(azimuth, np.nextafter(1.0, 0)), is_there, N_AZIMUTH),
            _histogram(np.minimum(elevation, np.nextafter(1.0, 0)), is_there, N_ELEVATION),
            *(_histogram(local[..., a] / (2 * half_range) + 0.5, is_there, N_COMPONENT) for a in range(3)),
        ]
        descriptors[part] = np.hstack(shares) / np.maximum(is_there.sum(axis=1), 1)[:, None]
    return descriptors


def _histogram(position: np.ndarray, is_there: np.ndarray, n_bins: int) -> Matrix:
    """Counts per row of positions in [0, 1): (k, s) to (k, n_bins)."""
    k = len(position)
    counts = is_there & (position >= 0) & (position < 1)
    bins = (np.clip(position, 0, 1) * n_bins).astype(np.int64) + n_bins * np.arange(k)[:, None]
    return np.bincount(bins[counts], minlength=k * n_bins).reshape(k, n_bins).astype(np.float64)
