# SPDX-License-Identifier: BSD-3-Clause
"""The prior as one 64 x 64 matrix per cell: integrated squared derivatives of the potential, and of div B.

With ``phi = h psi(u)`` and ``a = lengthscale / h`` the energy of one cell is ``w^T E w`` with

    E = sum_{k=0..3} (a^2 / 2)^k / k!  J_k  +  stiffness (a^4 / 8) L,

J_k the integral of ``|grad^k psi|^2`` and L that of ``(lap psi)^2`` over the unit cell. The sum is the series of
``exp(a^2 k^2 / 2)``, the inverse spectral density of the squared-exponential kernel, cut after the third term
(smoothness of a Matern field); L charges ``div B`` beyond it.
"""

from functools import cache, lru_cache
from math import factorial

import numpy as np

from magmatch.field.spline_basis import (
    CUBIC_COEFFICIENTS,
    SPLINES_PER_CELL,
)

HIGHEST_TERM = 3
# The prior all but ends where no sensor was: that is where the sources stand, and where the field may change fast.
# Factor per cell beyond the first ring; with 1 the rim of a room is a quarter less accurate.
OUTSIDE_DECAY = 0.01
# Splines carry no waves shorter than two cells, so the spectrum ends there (in radians per cell).
HIGHEST_WAVENUMBER, N_WAVENUMBERS = np.pi, 512


def cell_weights(distance: np.ndarray) -> np.ndarray:
    """Weight of each cell's energy.

    Parameters
    ----------
    distance : (c,) array
        From the nearest occupied cell, in cells.

    Returns
    -------
    (c,) array
        1 up to the first ring of neighbours, less beyond.
    """
    return np.asarray(OUTSIDE_DECAY ** np.maximum(distance - 1.0, 0.0))


@cache
def _axis_integrals() -> np.ndarray:
    """Integrals over 0..1 of products of spline derivatives: [p, q, i, j] = int b_i^(p) b_j^(q)."""
    nodes, weights = np.polynomial.legendre.leggauss(4)
    t, weights = (nodes + 1) / 2, weights / 2
    coefficients, values = CUBIC_COEFFICIENTS, []
    for _ in range(4):
        values.append(coefficients @ t[None] ** np.arange(4)[:, None])
        coefficients = np.concatenate([coefficients[:, 1:] * np.arange(1, 4), np.zeros((4, 1))], axis=1)
    v = np.array(values)
    return np.asarray(np.einsum("pit,qjt,t->pqij", v, v, weights))


def _tensor(x: np.ndarray, y: np.ndarray, z: np.ndarray) -> np.ndarray:
    """Product of three matrices of one axis each, in the numbering of a cell's splines."""
    return np.asarray(np.einsum("ai,bj,ck->abcijk", x, y, z).reshape(SPLINES_PER_CELL, SPLINES_PER_CELL))


@cache
def smoothness_matrix(k: int) -> np.ndarray:
    """J_k, the integral of the squared k-th derivatives of psi over the unit cell: (64, 64)."""
    integrals, J = _axis_integrals(), np.zeros((SPLINES_PER_CELL, SPLINES_PER_CELL))
    for i in range(k + 1):
        for j in range(k - i + 1):
            n = k - i - j
            count = factorial(k) // (factorial(i) * factorial(j) * factorial(n))
            J += count * _tensor(integrals[i, i], integrals[j, j], integrals[n, n])
    return J


@cache
def divergence_matrix() -> np.ndarray:
    """L, the integral of the squared Laplacian of psi over the unit cell: (64, 64)."""
    integrals, L = _axis_integrals(), np.zeros((SPLINES_PER_CELL, SPLINES_PER_CELL))
    twice = 2 * np.eye(3, dtype=int)
    for p in twice:
        for q in twice:
            L += _tensor(*(integrals[p[axis], q[axis]] for axis in range(3)))
    return L


@lru_cache(maxsize=64)
def prior_element(relative_lengthscale: float, stiffness: float) -> np.ndarray:
    """Prior precision of one cell, up to its scale.

    Parameters
    ----------
    relative_lengthscale : float
        a, lengthscale over spacing.
    stiffness : float
        Weight of div B = 0 beside the second term of the series.

    Returns
    -------
    (64, 64) array
    """
    half = relative_lengthscale**2 / 2
    E = sum(half**k / factorial(k) * smoothness_matrix(k) for k in range(HIGHEST_TERM + 1))
    return np.asarray(E + stiffness * half**2 / 2 * divergence_matrix())


def ball_offsets(radius: float) -> np.ndarray:
    """Offsets (n, 3) of the cells whose centres lie within a radius (in cells)."""
    r = int(np.floor(radius))
    axis = np.arange(-r, r + 1)
    offsets = np.stack(np.meshgrid(axis, axis, axis, indexing="ij"), axis=-1).reshape(-1, 3)
    return np.asarray(offsets[(offsets**2).sum(axis=1) <= radius**2 + 1e-9])


@lru_cache(maxsize=256)
def prior_covariance(relative_lengthscale: float, stiffness: float) -> np.ndarray:
    """Prior covariance of field and gradient in the middle of a large region, where the precision is that of the cells.

    The potential has the spectral density S(k), the inverse of `prior_element`'s symbol. With the moments
    ``m_n = integral of k^n S(k) over all k / (2 pi)^3``, a component of the field has variance ``m_2 / 3`` and the
    gradient, being symmetric and isotropic, ``cov(B_ij, B_kl) = m_4 / 15 (d_ij d_kl + d_ik d_jl + d_il d_jk)``.

    Parameters
    ----------
    relative_lengthscale, stiffness : float
        As in `prior_element`.

    Returns
    -------
    (9, 9) array
        Of the 3 field components and the 6 distinct gradient entries times the spacing.
    """
    step = HIGHEST_WAVENUMBER / N_WAVENUMBERS
    k = step * (np.arange(N_WAVENUMBERS) + 0.5)
    series = sum((relative_lengthscale**2 * k**2 / 2) ** n / factorial(n) for n in range(HIGHEST_TERM + 1))
    shell = k**2 / (2 * np.pi**2) * step / (series + stiffness * relative_lengthscale**4 * k**4 / 8)
    out = np.eye(9) * (k**2 @ shell) / 3
    same, mixed = np.array([3, 6, 8]), np.array([4, 5, 7])
    out[3:] = 0.0
    out[np.ix_(same, same)] = (k**4 @ shell) / 15 * (1 + 2 * np.eye(3))
    out[mixed, mixed] = (k**4 @ shell) / 15
    return np.asarray(out)
