# SPDX-License-Identifier: BSD-3-Clause
"""The published recursion: a Gaussian belief about the field at inducing points, updated as samples arrive.

With ``A = K(x, U) K_U^-1`` and the belief N(mu, Sigma) at U, corrected as in ``docs/theory/inducing.md``: predict
``b = A mu``, ``S_bb = A Sigma A^T + s^2 I``, ``S_bU = A Sigma``; update with the gain ``S_bU^T S_bb^-1``. The belief
is held as that of ``v = L^-1 f_U``, ``K_U = L L^T``, whose prior is N(0, I): the same recursion in coordinates where
rounding does not grow with the condition of ``K_U``.
"""

from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np
from scipy.linalg import blas, cho_factor, cho_solve, cholesky, solve_triangular

from magmatch.errors import ConfigurationError
from magmatch.field.inducing.gaussian_grid import GaussianGrid, chunks, rows_as_values
from magmatch.field.inducing.inducing_model import InducingPosterior, dense_prior, gram_factor
from magmatch.field.inducing.inducing_prior import JITTER
from magmatch.field.inducing.kernels import DIVERGENCE_FREE, N_ROWS, Kernel
from magmatch.field.linear_model import Index
from magmatch.field.map import FieldMap
from magmatch.field.values import FieldValues
from magmatch.progress import tell
from magmatch.typing import Matrix, Points, Scalars, Vectors


@dataclass(frozen=True, eq=False, slots=True)
class RecursiveField:
    """Belief about a field after some samples; `update` returns the next one.

    Attributes
    ----------
    kernel : Kernel
        Prior covariance of the field.
    inducing_points : (m, 3) array, m
    noise_sd, constant_sd : float, T
        Of a measured component, and of a constant field beside the kernel's (0 for none, as published).
    gram_factor : (3 m, 3 m) array, T
        Lower Cholesky factor of ``K_U``, the only factorisation.
    white_mean, white_covariance : (3 m + 3,) and (3 m + 3, 3 m + 3) arrays
        Of ``L^-1 f_U``, then of the constant field over its standard deviation.
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
    ) -> "RecursiveField":
        """Prior belief; the jitter on the diagonal of ``K_U`` is relative to the variance of one component."""
        if not noise_sd > 0:
            msg = f"expected a positive noise_sd, got {noise_sd} T"
            raise ValueError(msg)
        factor = gram_factor(kernel.covariance(inducing_points, inducing_points), jitter)
        n_weights = 3 * len(inducing_points) + 3
        mean, covariance = np.zeros(n_weights), np.eye(n_weights)
        return cls(kernel, inducing_points, noise_sd, constant_sd, factor, mean, covariance)

    def __repr__(self) -> str:
        return f"RecursiveField({len(self.inducing_points)} inducing points)"

    @property
    def inducing_mean(self) -> np.ndarray:
        """Mean mu of the field at the inducing points (without the constant), component-major: (3 m,), T."""
        return np.asarray(self.gram_factor @ self.white_mean[:-3])

    @property
    def inducing_covariance(self) -> Matrix:
        """Covariance Sigma of the field at the inducing points: (3 m, 3 m), T^2."""
        return np.asarray(self.gram_factor @ self.white_covariance[:-3, :-3] @ self.gram_factor.T)

    def update(self, points: Points, field: Vectors) -> "RecursiveField":
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

    def update_each(self, points: Points, field: Vectors) -> "RecursiveField":
        """Belief after samples (n, 3), one at a time as published: each costs the square of the inducing values."""
        mean, lower = self.white_mean.copy(), np.array(self.white_covariance, order="F")
        for rows in chunks(len(points), 3 * len(mean)):
            A = self._features(points[rows], 0).reshape(3, -1, len(mean))
            for i, b in enumerate(field[rows]):
                S_Ub = blas.dsymm(1.0, lower, A[:, i].T, lower=1)
                S_bb = A[:, i] @ S_Ub + self.noise_sd**2 * np.eye(3)
                innovation = cho_factor(S_bb, lower=True)
                mean += S_Ub @ cho_solve(innovation, b - A[:, i] @ mean)
                half = np.asfortranarray(solve_triangular(innovation[0], S_Ub.T, lower=True).T)
                lower = blas.dsyrk(-1.0, half, beta=1.0, c=lower, lower=1, overwrite_c=1)
        return replace(self, white_mean=mean, white_covariance=np.tril(lower) + np.tril(lower, -1).T)

    def mean(self, points: Points, order: int = 0) -> FieldValues:
        """Posterior mean of field and derivatives up to an order of 0, 1 or 2."""
        rows = self._features(points, order) @ self.white_mean
        return rows_as_values(rows.reshape(N_ROWS[order], len(points)), order)

    def sor_covariance(self, points: Points, order: int = 0) -> np.ndarray:
        """Covariance (T^2) as published (subset of regressors): falls to 0 far from the inducing points."""
        A = self._features(points, order)
        return _blocks(A, A @ self.white_covariance, N_ROWS[order])

    def dtc_covariance(self, points: Points) -> np.ndarray:
        """Covariance (T^2) that returns to the prior far from U: SoR plus ``K** - K*U K_U^-1 KU*``."""
        A = self._features(points, 0)
        explained = _blocks(A[:, :-3], A[:, :-3], 3)
        return np.asarray(_blocks(A, A @ self.white_covariance, 3) + self.kernel.at_one_point() - explained)

    def _features(self, points: Points, order: int) -> Matrix:
        """Field and derivatives per unit of each whitened weight: ``K(x, U) L^-T``, then the constant."""
        cross = self.kernel.covariance(points, self.inducing_points, order)
        white = solve_triangular(self.gram_factor, cross.T, lower=True).T
        constant = np.zeros((N_ROWS[order], len(points), 3))
        constant[range(3), :, range(3)] = self.constant_sd
        return np.hstack([white, constant.reshape(-1, 3)])


@dataclass(frozen=True, eq=False, slots=True)
class RecursivePosterior(InducingPosterior):
    """A fitted field whose covariance is the published one, of a belief."""

    belief: RecursiveField

    @property
    def weights_by_tile(self) -> Mapping[Index, Scalars]:
        """None: a map that is loaded or grown is fitted at once, which is another posterior."""
        msg = "a map inferred by the recursion can be neither saved nor grown: do so with the map it was made of"
        raise ConfigurationError(msg)

    def covariance(self, points: Points, order: int = 0) -> np.ndarray:
        """Posterior covariance of field (and gradient) at each point; 0 far from the inducing points (SoR)."""
        k = N_ROWS[order]
        parts = chunks(len(points), k * len(self.white))
        found = [self.belief.sor_covariance(points[rows], order) for rows in parts]
        return np.concatenate([np.zeros((0, k, k)), *found])


def recursively(field_map: FieldMap) -> FieldMap:
    """Infer a map of the published prior again, as published: zero mean, sample by sample, variance of the SoR.

    Parameters
    ----------
    field_map : FieldMap
        Of the prior ``divergence_free``; its hyperparameters and inducing points are kept.

    Returns
    -------
    FieldMap
        Of the same samples, which can be neither saved nor grown. It takes minutes where `build_map` takes seconds.

    Raises
    ------
    ConfigurationError
        A map of another prior.
    """
    posterior, numbers = field_map.posterior, field_map.hyperparameters
    if not isinstance(posterior, InducingPosterior) or field_map.config.prior != "divergence_free":
        msg = f"the recursion is of the prior 'divergence_free', got a map of '{field_map.config.prior}'"
        raise ConfigurationError(msg)
    basis = posterior.model.basis
    assert isinstance(basis, GaussianGrid)
    kernel = Kernel(DIVERGENCE_FREE, numbers.lengthscale, numbers.prior_scale * numbers.signal_sd)
    samples = field_map.survey.transformed(field_map.T_map_model.inv())
    tell(f"adding {len(samples)} samples one at a time")
    start = RecursiveField.start(kernel, basis.grid.nodes, numbers.noise_sd, jitter=JITTER)
    belief = start.update_each(samples.positions, samples.field)
    factor = dense_prior(basis.gram(), numbers, 0.0, JITTER)
    model = replace(posterior.model, constant_sd=0.0, factor=factor)
    precision = cholesky(np.linalg.inv(belief.white_covariance), lower=True)
    white = belief.white_mean
    return replace(
        field_map,
        posterior=RecursivePosterior(model, np.asfortranarray(precision), white, model.weights_of(white), belief),
    )


def _blocks(left: Matrix, right: Matrix, k: int) -> np.ndarray:
    """Products ``left right^T`` of each point's k rows with themselves: (n, k, k)."""
    shape = (k, len(left) // k, left.shape[1])
    return np.asarray(np.einsum("ank,bnk->nab", left.reshape(shape), right.reshape(shape), optimize=True))
