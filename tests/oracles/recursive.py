# SPDX-License-Identifier: BSD-3-Clause
"""The published recursion: a Gaussian belief about the field at inducing points, updated as samples arrive.

With ``A = K(x, U) K_U^-1`` and the belief N(mu, Sigma) at U, corrected as in ``docs/theory/inducing.md``: predict
``b = A mu``, ``S_bb = A Sigma A^T + s^2 I``, ``S_bU = A Sigma``; update with the gain ``S_bU^T S_bb^-1``. The belief
is held as that of ``v = L^-1 f_U``, ``K_U = L L^T``, whose prior is N(0, I): the same recursion in coordinates where
rounding does not grow with the condition of ``K_U``.
"""

from dataclasses import dataclass, replace

import numpy as np
from scipy.linalg import cho_factor, cho_solve, solve_triangular

from magmatch.field.inducing.inducing_model import gram_factor
from magmatch.field.inducing.kernels import N_ROWS, Kernel
from magmatch.field.values import FieldValues
from magmatch.typing import Matrix, Points, Vectors


@dataclass(frozen=True, eq=False, slots=True)
class RecursiveSparseGP:
    """Belief about a field after some samples; `update` returns the next one.

    ``gram_factor`` is the lower Cholesky factor of ``K_U``, the only factorisation. The white mean and covariance are
    of ``L^-1 f_U`` and of an added constant field over `constant_sd` (0 for none, as published).
    """

    kernel: Kernel
    inducing_points: Points
    noise_sd: float
    constant_sd: float
    gram_factor: Matrix
    white_mean: np.ndarray
    white_covariance: Matrix

    @classmethod
    def start(
        cls, kernel: Kernel, inducing_points: Points, noise_sd: float, constant_sd: float = 0.0, jitter: float = 1e-9
    ) -> "RecursiveSparseGP":
        """Prior belief; the jitter on the diagonal of ``K_U`` is relative to the variance of one component."""
        if not noise_sd > 0:
            msg = f"expected a positive noise_sd, got {noise_sd} T"
            raise ValueError(msg)
        factor = gram_factor(kernel.covariance(inducing_points, inducing_points), jitter)
        n_weights = 3 * len(inducing_points) + 3
        mean, covariance = np.zeros(n_weights), np.eye(n_weights)
        return cls(kernel, inducing_points, noise_sd, constant_sd, factor, mean, covariance)

    @property
    def inducing_mean(self) -> np.ndarray:
        """Mean mu of the field at the inducing points (without the constant), component-major: (3 m,), T."""
        return np.asarray(self.gram_factor @ self.white_mean[:-3])

    @property
    def inducing_covariance(self) -> Matrix:
        """Covariance Sigma of the field at the inducing points: (3 m, 3 m), T^2."""
        return np.asarray(self.gram_factor @ self.white_covariance[:-3, :-3] @ self.gram_factor.T)

    def update(self, points: Points, field: Vectors) -> "RecursiveSparseGP":
        """Belief after one more sample, or a block of them: the cost grows with the cube of its length."""
        A = self._features(points, 0)
        predicted = A @ self.white_mean
        S_bU = A @ self.white_covariance
        S_bb = S_bU @ A.T
        S_bb[np.diag_indices_from(S_bb)] += self.noise_sd**2
        innovation = cho_factor(S_bb, lower=True)
        mean = self.white_mean + S_bU.T @ cho_solve(innovation, field.T.ravel() - predicted)
        half = solve_triangular(innovation[0], S_bU, lower=True)
        return replace(self, white_mean=mean, white_covariance=self.white_covariance - half.T @ half)

    def mean(self, points: Points, order: int = 0) -> FieldValues:
        """Posterior mean of field and derivatives up to an order of 0, 1 or 2."""
        n = len(points)
        rows = (self._features(points, order) @ self.white_mean).reshape(N_ROWS[order], n)
        return FieldValues(
            np.ascontiguousarray(rows[:3].T),
            np.ascontiguousarray(rows[3:12].T).reshape(n, 3, 3) if order >= 1 else None,
            np.ascontiguousarray(rows[12:].T).reshape(n, 3, 3, 3) if order >= 2 else None,
        )

    def sor_covariance(self, points: Points) -> np.ndarray:
        """Covariance (T^2) as published (subset of regressors): falls to 0 far from the inducing points."""
        A = self._features(points, 0)
        return _blocks(A, A @ self.white_covariance)

    def dtc_covariance(self, points: Points) -> np.ndarray:
        """Covariance (T^2) that returns to the prior far from U: SoR plus ``K** - K*U K_U^-1 KU*``."""
        A = self._features(points, 0)
        explained = _blocks(A[:, :-3], A[:, :-3])
        return np.asarray(_blocks(A, A @ self.white_covariance) + self.kernel.at_one_point() - explained)

    def _features(self, points: Points, order: int) -> Matrix:
        """Field and derivatives per unit of each whitened weight: ``K(x, U) L^-T``, then the constant."""
        cross = self.kernel.covariance(points, self.inducing_points, order)
        white = solve_triangular(self.gram_factor, cross.T, lower=True).T
        constant = np.zeros((N_ROWS[order], len(points), 3))
        constant[range(3), :, range(3)] = self.constant_sd
        return np.hstack([white, constant.reshape(-1, 3)])


def _blocks(left: Matrix, right: Matrix) -> np.ndarray:
    """Products ``left right^T`` of each point's rows with themselves: (n, 3, 3)."""
    shape = (3, len(left) // 3, left.shape[1])
    return np.asarray(np.einsum("ank,bnk->nab", left.reshape(shape), right.reshape(shape), optimize=True))
