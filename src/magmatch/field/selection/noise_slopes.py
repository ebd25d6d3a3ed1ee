# SPDX-License-Identifier: BSD-3-Clause
"""Derivatives of evidence and noise level by the assumed noise, from one factor, with stochastic trace estimates.

With ``P0`` proportional to the noise's square and t its logarithm, for S and A of `spline_evidence`

    dS/dt = q = w^T P0 w,    dq/dt = q - 2 w^T P0 A^-1 P0 w,
    d ln det A/dt = T = tr A^-1 P0,    dT/dt = T - tr (A^-1 P0)^2,    d ln det P0/dt = m.

T is the mean of ``u^T P0 u`` over draws u of covariance ``A^-1`` (Hutchinson 1989, doi:10.1080/03610918908812806).
"""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from magmatch.field.cholesky.multifrontal import CholeskyFactor
from magmatch.typing import Scalars

# The top of the evidence is off by a few hundredths of the noise with so many.
N_PROBES = 4


@dataclass(frozen=True, slots=True)
class NoiseSlopes:
    """First and second derivatives by the logarithm of the assumed noise level.

    ``evidence``: of the tempered log evidence; ``level``: of the log of the noise level of the greatest likelihood.
    """

    evidence: tuple[float, float]
    level: tuple[float, float]


def noise_slopes(
    times_prior: Callable[[Scalars], Scalars],
    factor: CholeskyFactor,
    weights: Scalars,
    square: float,
    n_independent: float,
) -> NoiseSlopes:
    """Derivatives of the evidence at a fit."""
    m = len(weights)
    white = 2.0 * np.random.default_rng(0).integers(0, 2, (m, N_PROBES)) - 1
    draws = factor.solve_half(white)
    products = np.stack([times_prior(column) for column in (*draws.T, weights)], axis=1)
    squares = np.einsum("ij,ij->j", products, factor.solve(products))
    trace = float(np.einsum("ij,ij->", products[:, :-1], draws)) / N_PROBES
    q, trace_of_square = float(products[:, -1] @ weights), float(squares[:-1].mean())
    slope = q / square
    bend = (q - 2 * float(squares[-1])) / square - slope**2
    evidence = -0.5 * (n_independent * slope + trace - m), -0.5 * (n_independent * bend + trace - trace_of_square)
    # The noise's logarithm is half of t; a level is the root of its square.
    return NoiseSlopes((2 * evidence[0], 4 * evidence[1]), (slope, 2 * bend))
