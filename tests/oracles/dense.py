# SPDX-License-Identifier: BSD-3-Clause
"""The exact Gaussian process, cubic in the samples: the oracle that every faster model is tested against."""

from dataclasses import dataclass

import numpy as np

from magmatch.field.inducing.kernels import N_ROWS, Kernel
from magmatch.field.values import FieldValues


@dataclass(frozen=True, eq=False, slots=True)
class DenseGP:
    """Exact posterior of a field given samples, which may include an added constant field of a standard deviation."""

    kernel: Kernel
    points: np.ndarray
    field: np.ndarray
    noise_sd: float
    constant_sd: float = 0.0

    def mean(self, points, order=0):
        """Posterior mean of field and derivatives up to an order of 0, 1 or 2."""
        solution = np.linalg.solve(self._of_samples(), self.field.T.ravel())
        n, rows = len(points), (self._cross(points, order) @ solution).reshape(N_ROWS[order], -1).T
        return FieldValues(
            rows[:, :3],
            rows[:, 3:12].reshape(n, 3, 3) if order >= 1 else None,
            rows[:, 12:].reshape(n, 3, 3, 3) if order >= 2 else None,
        )

    def covariance(self, points, order=0):
        """Marginal posterior covariance at each point: of the field, with order 1 of the gradient too (row-major)."""
        prior, cross = self.kernel.at_one_point(order), self._cross(points, order)
        prior[:3, :3] += self.constant_sd**2 * np.eye(3)
        cross, solved = (
            rows.reshape(len(prior), len(points), -1)
            for rows in (cross, np.linalg.solve(self._of_samples(), cross.T).T)
        )
        return prior - np.einsum("ank,bnk->nab", cross, solved)

    def _of_samples(self):
        return self._cross(self.points, 0) + self.noise_sd**2 * np.eye(3 * len(self.points))

    def _cross(self, points, order):
        """Covariance of field and derivatives at points with the samples."""
        constant = np.zeros((N_ROWS[order], len(points), 3, len(self.points)))
        constant[range(3), :, range(3)] = self.constant_sd**2
        return self.kernel.covariance(points, self.points, order) + constant.reshape(N_ROWS[order] * len(points), -1)
