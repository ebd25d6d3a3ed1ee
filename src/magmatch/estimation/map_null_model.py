# SPDX-License-Identifier: BSD-3-Clause
"""The null model: the target's field is a smooth random field, unrelated to the base.

Cell means of the target's samples are modelled by a rational quadratic field around a free constant, with
maximum-likelihood lengthscale and strength for this survey. This gives the null model its best chance, and accounts
for the dependence between cells of a smooth field.
"""

from dataclasses import dataclass, replace
from itertools import product

import numpy as np
from scipy.linalg.lapack import dpotrf, dtrtrs
from scipy.spatial.distance import cdist
from scipy.special import logsumexp

from magmatch.estimation.cubes import cube_keys, even_choice
from magmatch.estimation.limits import MAX_WEIGHED
from magmatch.typing import Indices, Mask, Matrix, Points, Scalars, Vectors

# Tried lengthscales (in the survey's correlation length) and strengths (in the cells' standard deviation), and this
# share of each as the strength of a rough part that follows no smooth field (jitter of poses).
FACTORS, ROUGH_SHARE = np.geomspace(0.5, 4.0, 5), 0.06
# Tried variances of the field in an overlap, and of what the base leaves unexplained, in that of the whole survey.
VARIANCES = np.geomspace(1e-4, 10.0, 21)
# Share of modes that objects moved between the surveys may change, although the pose is right.
CHANGED_MODES = 0.1


@dataclass(frozen=True, eq=False, slots=True)
class CellMeans:
    """Samples averaged over cubic cells of the target."""

    cell: np.ndarray  # (n,) ints: which cell each sample belongs to; negative where its cell is left out
    counts: Scalars  # (c,)
    centers: Points  # (c, 3), m

    def mean(self, values: Matrix) -> Matrix:
        """Average rows over the cells: (c, k)."""
        kept = self.cell >= 0
        return np.stack(
            [
                np.bincount(self.cell[kept], column[kept], len(self.counts)) / np.maximum(self.counts, 1)
                for column in np.atleast_2d(values.T)
            ],
            axis=1,
        )

    def holds(self, rows: Indices) -> Mask:
        """Whether each sample lies in one of these cells: (n,)."""
        is_one = np.zeros(len(self.counts) + 1, dtype=np.bool_)
        is_one[rows] = True
        # Samples of cells that are left out, -1, look at the last entry.
        inside: Mask = is_one[self.cell]
        return inside


@dataclass(frozen=True, eq=False, slots=True)
class NullModel:
    """Covariance of the cells' field under the null hypothesis."""

    cells: CellMeans
    field: Vectors  # (c, 3), T: mean field of each cell
    covariance: Matrix  # (c, c), T^2: of one component between cells, noise left out
    noise: Scalars  # (c,), T^2: variance of one component of each cell's mean
    roughness: float  # T^2: further variance that follows no smooth field

    def log_ratio(self, residual: Vectors, extra: Scalars, rows: np.ndarray) -> tuple[float, float]:
        """Log of 'the base explains these cells' over 'unrelated field', nats; and the same without residuals.

        The cells' field and residual are decomposed into the independent modes of the unrelated field, smooth ones
        first. A mode counts by how far its residual is below the variance that the unrelated field has there, but at
        least as much as an outlier; modes weaker than the residuals do not count. The variance that the base leaves
        unexplained is unknown: the ratio is averaged over its values, so that none is chosen to suit the data, and
        its mean under the null model is at most 1.
        """
        # Cells in units of their own uncertainty, so that cells where the base map is uncertain count little.
        W = 1 / np.sqrt(self.noise[rows] + extra)
        covariance = self.covariance[np.ix_(rows, rows)] + self.roughness * np.eye(len(rows))
        power, modes = np.linalg.eigh(W[:, None] * covariance * W)
        constant = np.average(self.field[rows], axis=0, weights=W**2)
        b2 = ((modes.T @ (W[:, None] * (self.field[rows] - constant))) ** 2).sum(axis=1)
        # A search finds calm corners of a survey; an unrelated field would be as calm there.
        k = np.maximum(power, 0.0) * _strength_here(power, b2) + 1.0
        r2 = ((modes.T @ (W[:, None] * residual)) ** 2).sum(axis=1)
        variance = float(self.field.var(axis=0).mean() * (W**2).mean())
        v = np.minimum(k, 1.0 + VARIANCES[:, None] * variance)
        residuals = np.stack([r2, np.zeros_like(r2)])
        L = np.minimum(b2, 9 * k) / (2 * k) - residuals[:, None] / (2 * v) + 1.5 * np.log(k / v)
        L = np.logaddexp(np.log(CHANGED_MODES), np.log1p(-CHANGED_MODES) + L)
        # A mode weaker than the residual variance is no evidence for or against.
        found = np.where(v < 0.8 * k, L, 0.0).sum(axis=2)
        log_ratio, attainable = logsumexp(found, axis=1) - np.log(len(VARIANCES))
        return float(log_ratio), float(attainable)


def _strength_here(power: Scalars, b2: Scalars) -> float:
    """Maximum-likelihood strength of the field in the given cells, as a share of the whole survey's variance."""
    k = np.maximum(power, 0.0) * VARIANCES[:, None] + 1.0
    log_likelihood = -(b2 / (2 * k) + 1.5 * np.log(k)).sum(axis=1)
    return float(VARIANCES[int(np.argmax(log_likelihood))])


def average_cells(positions: Points, side: float) -> CellMeans:
    """Divide samples into cubic cells; if there are too many, an even choice of them."""
    _, cell, counts = np.unique(cube_keys(positions, side), return_inverse=True, return_counts=True)
    chosen = even_choice(len(counts), MAX_WEIGHED)
    renamed = np.full(len(counts), -1)
    renamed[chosen] = np.arange(len(chosen))
    means = CellMeans(renamed[cell], counts[chosen].astype(np.float64), np.zeros((0, 3)))
    return replace(means, centers=means.mean(positions))


@dataclass(frozen=True, slots=True)
class UnrelatedField:
    """A smooth random field with a rational-quadratic covariance, a mixture of lengthscales."""

    lengthscale: float  # m
    variance: float  # T^2: of one component
    roughness: float  # T^2: further variance that follows no smooth field

    @classmethod
    def most_likely(cls, cells: CellMeans, field: Vectors, noise: Scalars, lengthscale: float) -> "UnrelatedField":
        """The one that explains a survey's cells best."""
        distance2 = cdist(cells.centers, cells.centers, "sqeuclidean")
        variance = max(float(field.var(axis=0).mean()), float(noise.min()))
        tried = [
            cls(factor * lengthscale, strength**2 * variance, roughness**2 * variance)
            for factor, strength, roughness in product(FACTORS, FACTORS, (0.0, *(ROUGH_SHARE * FACTORS)))
        ]
        return max(tried, key=lambda f: _with_free_constant(field, f.between(distance2), noise + f.roughness))

    def between(self, distance2: Matrix) -> Matrix:
        """Covariance of one component between points, of their squared distances."""
        return rational_quadratic(distance2, self.lengthscale, self.variance)

    def over(self, cells: CellMeans, field: Vectors, noise: Scalars) -> NullModel:
        """Make it the null model of some cells."""
        covariance = self.between(cdist(cells.centers, cells.centers, "sqeuclidean"))
        return NullModel(cells, field, covariance, noise, self.roughness)


def rational_quadratic(
    distance2: Matrix, lengthscale: np.ndarray | float, variance: np.ndarray | float
) -> np.ndarray:
    """Covariance by squared distances: a mixture of lengthscales, as the field of sources at many distances is."""
    return np.asarray(variance / (1 + distance2 / (2 * lengthscale**2)))


def _with_free_constant(values: Vectors, K: Matrix, noise: Scalars) -> float:
    """Log density of values (n, 3) about their most likely constant, up to one that all models share."""
    total = K + np.diag(noise + 1e-9 * np.trace(K) / len(K))
    # LAPACK itself: of a hundred small matrices, what SciPy checks about each takes longer than its factor.
    L, info = dpotrf(total, lower=1, overwrite_a=1)
    if info:
        msg = f"covariance of cells is not positive definite: pivot {info} of {len(K)} fails"
        raise np.linalg.LinAlgError(msg)
    z, _ = dtrtrs(L, np.column_stack([values, np.ones(len(values))]), lower=1)
    one = z[:, 3]
    off = z[:, :3] - np.outer(one, one @ z[:, :3] / (one @ one))
    return float(-0.5 * (off**2).sum() - 3 * np.log(np.diag(L)).sum())
