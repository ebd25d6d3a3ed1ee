# SPDX-License-Identifier: BSD-3-Clause
"""The exact Gaussian process, cubic in the samples: the oracle that every faster model is tested against."""

from dataclasses import dataclass

import numpy as np
from scipy.linalg import cho_factor, cho_solve

from magmatch.field.inducing.kernels import N_ROWS, Kernel
from magmatch.field.values import FieldValues


@dataclass(frozen=True, eq=False, slots=True)
class DenseGP:
    """Exact posterior of a field given samples, which may include an added constant field of a standard deviation.

    ``factor`` is that of the samples' covariance C, noise included; ``solution`` C^-1 y, component-major.
    """

    kernel: Kernel
    points: np.ndarray
    factor: tuple[np.ndarray, bool]
    solution: np.ndarray
    constant_sd: float = 0.0

    @classmethod
    def fit(cls, kernel, points, field, noise_sd, constant_sd=0.0):
        """Condition the prior on samples (m, T)."""
        prior = cls(kernel, points, None, None, constant_sd)
        factor = cho_factor(prior._cross(points, 0) + noise_sd**2 * np.eye(3 * len(points)))
        return cls(kernel, points, factor, cho_solve(factor, field.T.ravel()), constant_sd)

    def mean(self, points, order=0):
        """Posterior mean of field and derivatives up to an order of 0, 1 or 2: K C^-1 y."""
        n, rows = len(points), (self._cross(points, order) @ self.solution).reshape(N_ROWS[order], -1).T
        return FieldValues(
            rows[:, :3],
            rows[:, 3:12].reshape(n, 3, 3) if order >= 1 else None,
            rows[:, 12:].reshape(n, 3, 3, 3) if order >= 2 else None,
        )

    def covariance(self, points, order=0):
        """Marginal posterior covariance at each point, of the gradient too with order 1: K_** - K C^-1 K^T."""
        prior, cross = self.kernel.at_one_point(order), self._cross(points, order)
        prior[:3, :3] += self.constant_sd**2 * np.eye(3)
        shape = len(prior), len(points), -1
        solved = cho_solve(self.factor, cross.T).T.reshape(shape)
        return prior - np.einsum("ank,bnk->nab", cross.reshape(shape), solved)

    def _cross(self, points, order):
        """Covariance of field and derivatives at points with the samples."""
        constant = np.zeros((N_ROWS[order], len(points), 3, len(self.points)))
        constant[range(3), :, range(3)] = self.constant_sd**2
        return self.kernel.covariance(points, self.points, order) + constant.reshape(N_ROWS[order] * len(points), -1)
