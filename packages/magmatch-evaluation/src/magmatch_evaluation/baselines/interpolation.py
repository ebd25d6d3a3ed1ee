# SPDX-License-Identifier: BSD-3-Clause
"""Interpolators of samples, which one would use instead of a field map; each chooses its own numbers."""

import numpy as np
from scipy.linalg import cho_factor, cho_solve
from scipy.optimize import minimize
from scipy.spatial import cKDTree
from scipy.spatial.distance import cdist

from magmatch.typing import Points, Scalars, Vectors

# Samples that numbers are chosen on, and neighbours that a prediction is made from.
N_LIKELIHOOD, N_LOCAL, N_WEIGHTED = 500, 64, 8
BATCH = 500


def nearest_neighbour(points: Points, field: Vectors, queries: Points) -> Vectors:
    """Field (T) of the nearest sample; points and queries in m."""
    return np.asarray(field[cKDTree(points).query(queries)[1]])


def inverse_distance(points: Points, field: Vectors, queries: Points) -> Vectors:
    """Shepard's weights of the 8 nearest samples, inverse squares."""
    distance, near = (np.asarray(a) for a in cKDTree(points).query(queries, k=N_WEIGHTED))
    weight = 1 / np.maximum(distance, 1e-6) ** 2
    mean: Vectors = np.einsum("nk,nka->na", weight / weight.sum(axis=1, keepdims=True), field[near])
    return mean


def local_gp(points: Points, field: Vectors, queries: Points) -> Vectors:
    """Ordinary kriging from the nearest samples, one kernel per component: a Gaussian process of unknown mean."""
    numbers = [likeliest(points, field[:, a]) for a in range(3)]
    near = np.asarray(cKDTree(points).query(queries, k=min(N_LOCAL, len(points)))[1])
    out = np.empty((len(queries), 3))
    for start in range(0, len(queries), BATCH):
        rows = near[start : start + BATCH]
        x = points[rows]
        between = ((x[:, :, None] - x[:, None]) ** 2).sum(axis=-1)
        across = ((x - queries[start : start + BATCH, None]) ** 2).sum(axis=-1)
        for a, (length, signal, noise) in enumerate(numbers):
            mean = 100 * signal  # variance of the unknown mean
            kernel = signal * np.exp(-0.5 * between / length**2) + mean + noise * np.eye(rows.shape[1])
            cross, y = signal * np.exp(-0.5 * across / length**2) + mean, field[rows, a]
            offset = y.mean(axis=1)
            alpha = np.linalg.solve(kernel, (y - offset[:, None])[..., None])[..., 0]
            out[start : start + BATCH, a] = offset + np.einsum("nk,nk->n", cross, alpha)
    return out


def likeliest(points: Points, values: Scalars) -> tuple[float, float, float]:
    """Lengthscale (m), signal and noise variance (T^2) of a squared-exponential kernel by marginal likelihood.

    From an even part of the samples (m, T).
    """
    rows = np.arange(0, len(points), -(-len(points) // N_LIKELIHOOD))
    square, y = cdist(points[rows], points[rows], "sqeuclidean"), values[rows] - values[rows].mean()
    scale = float(y.std())

    def loss(log_numbers: np.ndarray) -> tuple[float, np.ndarray]:
        length, signal, noise = np.exp(log_numbers)
        kernel = signal * np.exp(-0.5 * square / length**2)
        factor = cho_factor(kernel + (noise + 1e-9) * np.eye(len(y)), lower=True)
        alpha = cho_solve(factor, y / scale)
        inner = cho_solve(factor, np.eye(len(y))) - np.outer(alpha, alpha)
        slopes = (kernel * square / length**2, kernel, noise * np.eye(len(y)))
        value = 0.5 * y @ alpha / scale + np.log(np.diagonal(factor[0])).sum()
        return float(value), np.array([0.5 * np.einsum("ij,ji", inner, slope) for slope in slopes])

    limits = [np.log(np.ptp(points, axis=0).max() * np.array([1e-3, 1.0])), np.log([1e-2, 1e3]), np.log([1e-6, 1.0])]
    tries = [
        minimize(loss, np.log([length, 1.0, 0.01]), jac=True, bounds=limits, options={"maxiter": 30})
        for length in (0.3, 1.5)
    ]
    length, signal, noise = np.exp(min(tries, key=lambda found: float(found.fun)).x)
    return float(length), float(signal * scale**2), float(noise * scale**2)
