# SPDX-License-Identifier: BSD-3-Clause
"""A dense basis plus a constant field as a linear model: Gaussians on inducing points, or equivalent sources.

``B(x) = K(x, U) w + c`` with ``w ~ N(0, K_UU^-1)``, or independent weights, and ``c ~ N(0, constant_sd^2 I)``.
Everything is computed in whitened weights v, ``[w, c] = s L^-T v`` with ``L L^T / s^2`` the prior precision: their
prior is N(0, I), so that neither the unit of the field nor the condition of ``K_UU`` reaches the factorisation of the
posterior.
"""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Protocol

import numpy as np
from scipy.linalg import LinAlgError, blas, cho_solve, cholesky, solve_triangular
from scipy.spatial import cKDTree

from magmatch.field.hyperparameters import Hyperparameters
from magmatch.field.inducing.gaussian_grid import chunks
from magmatch.field.inducing.kernels import N_ROWS, Kernel
from magmatch.field.linear_model import Index, Piece, StoredTile
from magmatch.field.values import FieldValues
from magmatch.runner import Workers
from magmatch.typing import Mask, Matrix, Points, Scalars, Vector3, Vectors

# Stands for a constant field that is held at zero, T.
_NO_CONSTANT_SD = 1e-30


class Basis(Protocol):
    """Vector fields that weights (T) stand for, with unit prior variance: Gaussians on a grid, or charges."""

    @property
    def n_weights(self) -> int:
        """How many."""

    def is_whole(self, points: Points) -> Mask:
        """Say where the basis alone is the prior; elsewhere the prior has a part that the basis cannot represent."""

    def design(self, points: Points, order: int = 0) -> Matrix:
        """Field and derivatives per unit of each weight: (rows n, m), rows component-major."""

    def evaluate(self, points: Points, weights: np.ndarray, order: int, constant: Vector3) -> FieldValues:
        """Field and derivatives at points."""


@dataclass(frozen=True, eq=False, slots=True)
class DenseInformation:
    """The samples' information on whitened weights, in units of the noise: sums over samples, so they subtract."""

    gram: Matrix  # (m, m): ``sum A^T A / s^2``, lower triangle
    eta: Scalars  # (m,): ``sum A^T b / s^2``

    def __sub__(self, other: "DenseInformation") -> "DenseInformation":
        """Leave samples out."""
        return DenseInformation(self.gram - other.gram, self.eta - other.eta)


def gram_factor(gram: Matrix, jitter: float) -> Matrix:
    """Lower Cholesky factor of the inducing points' covariance: it turns weights into ones with prior N(0, I)."""
    largest = float(gram.diagonal().max(initial=0.0))
    gram[np.diag_indices_from(gram)] += jitter * largest
    try:
        return np.asfortranarray(cholesky(gram, lower=True, check_finite=False))
    except LinAlgError as error:
        smallest = float(np.linalg.eigvalsh(gram / largest)[0])
        msg = (
            f"the covariance of {len(gram)} inducing values is not positive definite ({error}; smallest eigenvalue "
            f"{smallest:.1e} of the variance): inducing points coincide or are too dense for jitter {jitter:.1e}"
        )
        raise ValueError(msg) from error


def dense_prior(gram: Matrix, h: Hyperparameters, constant_sd: float, jitter: float) -> Matrix:
    """Factor of an `InducingModel` whose weights have this Gram matrix as their prior's precision."""
    n = len(gram)
    factor = np.zeros((n + 3, n + 3), order="F")
    factor[:n, :n] = gram_factor((gram + gram.T) / 2, jitter)
    factor[:n, :n] *= h.noise_sd / (h.prior_scale * h.signal_sd)
    factor[range(n, n + 3), range(n, n + 3)] = h.noise_sd / max(constant_sd, _NO_CONSTANT_SD)
    return factor


@dataclass(frozen=True, eq=False, slots=True)
class InducingModel:
    """A dense basis over a region, with fixed hyperparameters."""

    hyperparameters: Hyperparameters
    basis: Basis
    kernel: Kernel  # prior covariance of the field, for unit variance, where the basis alone is not the prior
    constant_sd: float  # T: prior standard deviation of the constant field
    # (m, m) or (m,): lower Cholesky factor of the weights' prior precision times the noise variance, the constant
    # included; its diagonal alone where the weights are independent
    factor: np.ndarray
    samples: cKDTree  # where the region's samples are
    known_reach: float  # m: distance from a sample within which the field counts as known
    # Sources among the samples: what lies nearer to one of these than to any sample does not count as known
    sources: cKDTree | None = None

    def observe(self, points: Points, field: Vectors) -> DenseInformation:
        """Information in samples."""
        m, b = len(self.factor), np.asarray(field, dtype=np.float64) / self.hyperparameters.noise_sd
        gram, eta = np.zeros((m, m), order="F"), np.zeros(m)
        for rows in chunks(len(points), 3 * m):
            A = self.features(points[rows], 0)
            gram = blas.dsyrk(1.0, A, beta=1.0, c=gram, lower=1, overwrite_c=1)
            eta += A @ b[rows].T.ravel()
        return DenseInformation(gram, eta)

    def infer(self, information: DenseInformation) -> "InducingPosterior":
        """Posterior of the weights given information."""
        precision = information.gram.copy(order="F")
        precision[np.diag_indices_from(precision)] += 1.0
        try:
            factor = cholesky(precision, lower=True, overwrite_a=True, check_finite=False)
        except LinAlgError as error:
            smallest = float(np.linalg.eigvalsh(information.gram, "L")[0])
            msg = (
                f"the posterior precision is not positive definite ({error}): the information has the eigenvalue "
                f"{smallest:.1e}, expected none below 0 (was more subtracted than had been added?)"
            )
            raise ValueError(msg) from error
        factor = np.asfortranarray(factor)
        half = solve_triangular(factor, information.eta, lower=True)
        white = solve_triangular(factor, half, lower=True, trans=1)
        return InducingPosterior(self, factor, white, self.weights_of(white))

    def fit(
        self, points: Points, field: Vectors, _stored: Mapping[Index, StoredTile], _run: Workers | None, /
    ) -> "InducingPosterior":
        """Posterior of samples: one piece, which loading fits again."""
        return self.infer(self.observe(points, field))

    def features(self, points: Points, order: int) -> Matrix:
        """Field and derivatives per unit of each whitened weight, in units of the noise: (m, rows n), by columns."""
        n, m = len(points), self.basis.n_weights
        design = np.zeros((N_ROWS[order] * n, m + 3))
        design[:, :m] = self.basis.design(points, order)
        for a in range(3):
            design[a * n : (a + 1) * n, m + a] = 1.0
        if self.factor.ndim == 1:
            design /= self.factor
            return design.T
        return np.asarray(blas.dtrsm(1.0, self.factor, design.T, lower=1, overwrite_b=1))

    def weights_of(self, white: np.ndarray) -> np.ndarray:
        """Weights (T) that whitened weights (m,) or (m, k) stand for."""
        if self.factor.ndim == 1:
            return np.asarray(self.hyperparameters.noise_sd * (white.T / self.factor).T)
        return np.asarray(self.hyperparameters.noise_sd * solve_triangular(self.factor, white, lower=True, trans=1))


@dataclass(frozen=True, eq=False, slots=True)
class InducingPosterior:
    """A fitted field."""

    model: InducingModel
    factor: Matrix  # (m, m): lower Cholesky factor of the whitened weights' posterior precision
    white: np.ndarray  # (m,): posterior mean of the whitened weights
    # (m,), T: posterior mean of the weights: of the inducing points, component-major, then the constant field
    weights: np.ndarray

    @property
    def hyperparameters(self) -> Hyperparameters:
        """Numbers that shape the prior."""
        return self.model.hyperparameters

    @property
    def weights_by_tile(self) -> Mapping[Index, Scalars]:
        """None: loading fits the samples again."""
        return {}

    def evaluate(self, points: Points, order: int = 0, weights: Scalars | None = None) -> FieldValues:
        """Field and derivatives at points, by default of the posterior mean."""
        w = self.weights if weights is None else np.asarray(weights, dtype=np.float64)
        return self.model.basis.evaluate(points, w[:-3], order, w[-3:])

    def covariance(self, points: Points, order: int = 0) -> np.ndarray:
        """Posterior covariance of field (and gradient) at each point; the prior's far from the samples (DTC)."""
        k = N_ROWS[order]
        h = self.hyperparameters
        prior = (h.prior_scale * h.signal_sd) ** 2 * self.model.kernel.at_one_point(order)
        prior[:3, :3] += self.model.constant_sd**2 * np.eye(3)
        out = np.empty((len(points), k, k))
        is_whole = self.model.basis.is_whole(points)
        for rows in chunks(len(points), k * len(self.factor)):
            A = self.model.features(points[rows], order)
            beside = prior - h.noise_sd**2 * _squares(A, k)
            beside[is_whole[rows]] = 0.0
            remaining = _squares(blas.dtrsm(1.0, self.factor, A, lower=1, overwrite_b=1), k)
            out[rows] = beside + h.noise_sd**2 * remaining
        # The prior is widened too: held-out samples found its numbers too sure, not the weights alone.
        out *= h.inflation**2
        return out

    def influence(self, points: Points) -> np.ndarray:
        """How the fitted field at samples follows what was measured at them: (3 n, 3 n), row ``3 i + a``."""
        features = self.model.features(points, 0)
        half = blas.dtrsm(1.0, self.factor, features, lower=1, overwrite_b=1)
        n = len(points)
        # From rows a n + i, component by component, to rows 3 i + a.
        return np.asarray((half.T @ half).reshape(3, n, 3, n).transpose(1, 0, 3, 2).reshape(3 * n, 3 * n))

    def pieces(self, points: Points) -> list[Piece]:
        """One."""
        return [Piece.whole(self, points)]

    def loads(self, points: Points, fields: np.ndarray) -> Matrix:
        """Loads of the whitened weights, in units of the noise: (m, k)."""
        by_component = np.swapaxes(fields, 0, 1).reshape(3 * len(points), -1)
        return np.asarray(self.model.features(points, 0) @ by_component)

    def solve(self, loads: Matrix) -> Matrix:
        """Whitened weights of the fields that are fitted to others."""
        return np.asarray(cho_solve((self.factor, True), loads))

    def draw_weights(self, n_draws: int, rng: np.random.Generator) -> Matrix:
        """Posterior samples of the weights, (n_draws, m)."""
        noise = rng.standard_normal((len(self.white), n_draws))
        noise *= self.hyperparameters.inflation
        white = self.white[:, None] + solve_triangular(self.factor, noise, lower=True, trans=1)
        return np.ascontiguousarray(self.model.weights_of(white).T)

    def without_factors(self) -> "InducingPosterior":
        """It is small as it is."""
        return self

    def knows(self, points: Points) -> Mask:
        """Whether each point lies near a sample of the region the model was laid over."""
        model = self.model
        distance, _ = model.samples.query(points, distance_upper_bound=model.known_reach)
        is_known = np.isfinite(distance)
        if model.sources is not None:
            is_known &= model.sources.query(points, distance_upper_bound=model.known_reach)[0] > distance
        return np.asarray(is_known)


def _squares(A: Matrix, k: int) -> np.ndarray:
    """Products of each point's k columns with themselves: (n, k, k)."""
    rows = A.T.reshape(k, -1, len(A))
    out = np.empty((rows.shape[1], k, k))
    for a in range(k):
        for b in range(a + 1):
            out[:, a, b] = out[:, b, a] = np.einsum("nm,nm->n", rows[a], rows[b])
    return out
