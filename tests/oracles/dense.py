# SPDX-License-Identifier: BSD-3-Clause
"""The exact Gaussian process, cubic in the samples: the oracle that every faster model is tested against."""

from dataclasses import dataclass

import numpy as np
from scipy.linalg import LinAlgError, cholesky, solve_triangular

from magmatch.field.inducing.kernels import N_ROWS, Kernel
from magmatch.field.values import FieldValues
from magmatch.typing import Matrix, Points, Vectors

# 4,000 samples: a matrix of 1.2 GB, about a minute on one core.
MAX_SAMPLES = 4000


@dataclass(frozen=True, eq=False, slots=True)
class DenseGP:
    """Exact posterior of a field given samples, which may include an added constant field of a standard deviation.

    ``factor`` is the lower Cholesky factor of the samples' covariance, noise included; ``solution`` that covariance's
    inverse times the samples, component-major.
    """

    kernel: Kernel
    points: Points
    factor: Matrix
    solution: np.ndarray
    constant_sd: float = 0.0

    @classmethod
    def fit(
        cls, kernel: Kernel, points: Points, field: Vectors, noise_sd: float, constant_sd: float = 0.0
    ) -> "DenseGP":
        """Condition the prior on samples (m, T)."""
        if len(points) > MAX_SAMPLES:
            msg = f"expected at most {MAX_SAMPLES} samples for the exact model, got {len(points)}: use a sparse one"
            raise ValueError(msg)
        covariance = kernel.covariance(points, points) + _constant(constant_sd, len(points), len(points), 0)
        covariance[np.diag_indices_from(covariance)] += noise_sd**2
        largest = float(covariance.diagonal().max(initial=0.0))
        try:
            factor = cholesky(covariance / largest, lower=True, overwrite_a=True, check_finite=False)
        except LinAlgError as error:
            msg = (
                f"the covariance of {len(points)} samples is not positive definite ({error}): noise_sd {noise_sd} T "
                f"is too small against {np.sqrt(largest)} T"
            )
            raise ValueError(msg) from error
        factor *= np.sqrt(largest)
        half = solve_triangular(factor, field.T.ravel(), lower=True)
        return cls(kernel, points, factor, solve_triangular(factor, half, lower=True, trans=1), constant_sd)

    def mean(self, points: Points, order: int = 0) -> FieldValues:
        """Posterior mean of field and derivatives up to an order of 0, 1 or 2."""
        rows = (self._cross(points, order) @ self.solution).reshape(N_ROWS[order], -1)
        n = len(points)
        return FieldValues(
            np.ascontiguousarray(rows[:3].T),
            np.ascontiguousarray(rows[3:12].T).reshape(n, 3, 3) if order >= 1 else None,
            np.ascontiguousarray(rows[12:].T).reshape(n, 3, 3, 3) if order >= 2 else None,
        )

    def covariance(self, points: Points, order: int = 0) -> np.ndarray:
        """Marginal posterior covariance at each point: of the field, with order 1 of the gradient too (row-major)."""
        prior = self.kernel.at_one_point(order)
        prior[:3, :3] += self.constant_sd**2 * np.eye(3)
        half = solve_triangular(self.factor, self._cross(points, order).T, lower=True)
        half = half.reshape(len(self.factor), len(prior), len(points))
        return np.asarray(prior - np.einsum("kan,kbn->nab", half, half, optimize=True))

    def _cross(self, points: Points, order: int) -> Matrix:
        """Covariance of field and derivatives at points with the samples."""
        constant = _constant(self.constant_sd, len(points), len(self.points), order)
        return np.asarray(self.kernel.covariance(points, self.points, order) + constant)


def _constant(constant_sd: float, n: int, m: int, order: int) -> Matrix:
    """Covariance of a constant field at n and m points: (rows n, 3 m)."""
    out = np.zeros((N_ROWS[order], n, 3, m))
    for a in range(3):
        out[a, :, a] = constant_sd**2
    stacked: Matrix = out.reshape(N_ROWS[order] * n, 3 * m)
    return stacked
