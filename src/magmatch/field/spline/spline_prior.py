# SPDX-License-Identifier: BSD-3-Clause
"""The prior of the splines in units of the noise, and its value where there are no splines."""

from functools import cache, lru_cache
from math import factorial

import numpy as np
import scipy.linalg

from magmatch.field.cholesky.cells import LOCAL_NODES, ball_offsets
from magmatch.field.hyperparameters import Hyperparameters
from magmatch.field.spline.spline_basis import GRADIENT_INDEX, derivative_rows, derivative_table, spline_values

HIGHEST_TERM = 3
# The prior all but ends where no sensor was: that is where the sources stand, and where the field may change fast.
# Factor per cell beyond the first ring; with 1 the rim of a room is a quarter less accurate.
OUTSIDE_DECAY = 0.01
# Prior standard deviation of the constant field, T: broad against the Earth's (25 to 65 uT) and a sensor's offset. A
# zero-mean field of that size would otherwise dictate lengthscale and signal.
CONSTANT_SD = 1e-4
# Finer spacings than this share of the lengthscale change nothing but rounding errors.
HIGHEST_RELATIVE_LENGTHSCALE = 12.0


def prior_terms(h: Hyperparameters) -> tuple[np.ndarray, np.ndarray]:
    """Element matrix of the prior and what it says about a lone sample's cell (both up to scale)."""
    relative = min(h.lengthscale / h.spacing, HIGHEST_RELATIVE_LENGTHSCALE)
    return prior_element(relative, h.divergence_weight), lone_cell_covariance(relative, h.divergence_weight, h.reach)


@lru_cache(maxsize=64)
def prior_element(relative_lengthscale: float, divergence_weight: float) -> np.ndarray:
    """Prior precision of one cell, up to its scale."""
    half = relative_lengthscale**2 / 2
    E = sum(half**k / factorial(k) * smoothness_matrix(k) for k in range(HIGHEST_TERM + 1))
    return np.asarray(E + divergence_weight * half**2 / 2 * divergence_matrix())


@cache
def smoothness_matrix(k: int) -> np.ndarray:
    """J_k, the integral of the squared k-th derivatives of psi over the unit cell: (64, 64)."""
    integrals, J = _axis_integrals(), np.zeros((len(LOCAL_NODES), len(LOCAL_NODES)))
    for i in range(k + 1):
        for j in range(k - i + 1):
            n = k - i - j
            count = factorial(k) // (factorial(i) * factorial(j) * factorial(n))
            J += count * _tensor(integrals[i, i], integrals[j, j], integrals[n, n])
    return J


@cache
def _axis_integrals() -> np.ndarray:
    """Integrals over 0..1 of products of spline derivatives: [p, q, i, j] = int b_i^(p) b_j^(q)."""
    nodes, weights = np.polynomial.legendre.leggauss(4)
    t, weights, start = (nodes + 1) / 2, weights / 2, np.zeros((4, 4))
    spline_values(0.0, start)
    # Row i: coefficients (of 1, t, t^2, t^3) of the i-th spline, by Taylor.
    coefficients, values = np.ascontiguousarray(start.T) / [factorial(k) for k in range(4)], []
    for _ in range(4):
        values.append(coefficients @ t[None] ** np.arange(4)[:, None])
        coefficients = np.concatenate([coefficients[:, 1:] * np.arange(1, 4), np.zeros((4, 1))], axis=1)
    v = np.array(values)
    return np.asarray(np.einsum("pit,qjt,t->pqij", v, v, weights))


def _tensor(x: np.ndarray, y: np.ndarray, z: np.ndarray) -> np.ndarray:
    """Product of three matrices of one axis each, in the numbering of a cell's splines."""
    return np.asarray(np.einsum("ai,bj,ck->abcijk", x, y, z).reshape(len(LOCAL_NODES), len(LOCAL_NODES)))


@cache
def divergence_matrix() -> np.ndarray:
    """L, the integral of the squared Laplacian of psi over the unit cell: (64, 64)."""
    integrals, L = _axis_integrals(), np.zeros((len(LOCAL_NODES), len(LOCAL_NODES)))
    twice = 2 * np.eye(3, dtype=int)
    for p in twice:
        for q in twice:
            L += _tensor(*(integrals[p[axis], q[axis]] for axis in range(3)))
    return L


@lru_cache(maxsize=64)
def lone_cell_covariance(relative_lengthscale: float, divergence_weight: float, reach: float) -> np.ndarray:
    """Prior covariance of field and gradient in a cell with nothing but its reach around it.

    This is what the prior says where a single sample was taken, and so the scale by which `signal_sd` is defined:
    the precision of all cells is ``v / signal_sd^2 E`` with v the field entry of this matrix.
    """
    offsets = ball_offsets(reach)
    cells = offsets - offsets.min(axis=0)
    width = cells.max(axis=0) + 4
    touched = (cells[:, None] + LOCAL_NODES).reshape(-1, 3)
    nodes, flat = np.unique(np.ravel_multi_index(tuple(touched.T), tuple(width)), return_inverse=True)
    flat = flat.reshape(-1, len(LOCAL_NODES))
    Q = np.zeros((len(nodes), len(nodes)))
    E = prior_element(relative_lengthscale, divergence_weight)
    distance = np.sqrt((offsets**2).sum(axis=1))
    for n, weight in zip(flat, cell_weights(distance), strict=True):
        Q[np.ix_(n, n)] += weight * E
    own = flat[int(np.argmin(distance))]
    factor = scipy.linalg.cho_factor(Q, lower=True)
    block = scipy.linalg.cho_solve(factor, np.eye(len(nodes))[:, own])[own]
    return _average_over_cell(block)


def cell_weights(distance: np.ndarray) -> np.ndarray:
    """Weight of each cell's energy."""
    return np.asarray(OUTSIDE_DECAY ** np.maximum(distance - 1.0, 0.0))


def _average_over_cell(block: np.ndarray) -> np.ndarray:
    """Covariance of field and gradient from that of a cell's weights, averaged over the cell, made isotropic."""
    nodes, weights = np.polynomial.legendre.leggauss(4)
    t, weights = (nodes + 1) / 2, weights / 2
    tables = np.zeros((4, 4, 4))
    for i in range(4):
        spline_values(t[i], tables[i])
    mean, rows = np.zeros((9, 9)), np.zeros((9, len(LOCAL_NODES)))
    for i, j, k in np.ndindex(4, 4, 4):
        derivative_rows(tables[i], tables[j], tables[k], derivative_table(1), 1.0, rows)
        mean += weights[i] * weights[j] * weights[k] * rows @ block @ rows.T
    same, mixed = np.array([3, 6, 8]), np.array([4, 5, 7])
    out = np.zeros((9, 9))
    out[:3, :3] = np.eye(3) * np.trace(mean[:3, :3]) / 3
    across = (mean[np.ix_(same, same)].sum() - np.trace(mean[np.ix_(same, same)])) / 6
    out[np.ix_(same, same)] = across
    out[same, same] = mean[same, same].mean()
    out[mixed, mixed] = mean[mixed, mixed].mean()
    return out


def relative_prior_precision(h: Hyperparameters) -> float:
    """Factor from the prior's shape to the prior, in units of the noise."""
    return (h.noise_sd / (h.prior_scale * h.signal_sd)) ** 2


def constant_precision(h: Hyperparameters) -> float:
    """Prior precision of the constant field in units of the noise's."""
    return (h.noise_sd / CONSTANT_SD) ** 2


def cell_precision(h: Hyperparameters) -> np.ndarray:
    """Prior precision of one cell of weight 1 in units of the noise's: (64, 64)."""
    element, covariance = prior_terms(h)
    return np.asarray(element * (relative_prior_precision(h) * covariance[0, 0]))


def prior_outside(h: Hyperparameters) -> np.ndarray:
    """Prior covariance of field and distinct gradient entries where there are no splines: (9, 9)."""
    prior = prior_terms(h)[1] / prior_terms(h)[1][0, 0]
    per_spacing = np.repeat([1.0, 1.0 / h.spacing], [3, 6])
    return np.asarray(h.signal_sd**2 * prior * np.outer(per_spacing, per_spacing))


def outside_covariance(h: Hyperparameters, constant: np.ndarray) -> np.ndarray:
    """Covariance of field and gradient (row-major) where there is only a constant, of given covariance: (12, 12)."""
    covariance = expand(prior_outside(h)[None])[0]
    covariance[:3, :3] += constant
    return np.asarray(covariance)


def expand(covariance: np.ndarray) -> np.ndarray:
    """From field and 6 distinct gradient entries to field and all 9, row-major."""
    rows = np.concatenate([np.arange(3), 3 + GRADIENT_INDEX.ravel()])
    return np.asarray(covariance[:, rows[:, None], rows])
