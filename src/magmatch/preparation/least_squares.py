# SPDX-License-Identifier: BSD-3-Clause
"""Least squares for a few unknowns beside a map; directions that the data do not determine are kept at zero."""

from collections.abc import Callable, Collection, Mapping
from dataclasses import dataclass

import numpy as np
from scipy.linalg import eigh
from scipy.special import fdtrc

from magmatch.data.sensor_axes import RESOLVED
from magmatch.typing import Matrix, Scalars

# (k, n, 3) columns -> (left, right), both (k, n, 3): what the data say of columns i and j is sum left_i right_j.
Projection = Callable[[np.ndarray], tuple[np.ndarray, np.ndarray]]
# A direction is fixed by the data when they know it this many times better (in variance) than what was expected
# before: to a fifth, 10 uT of hard iron or 1 % of soft iron. What is known worse is better left alone.
LEAST_INFORMATION = 25.0
# Where readings are columns, too, noise spreads these in every direction. A direction is seen if the spread along it
# is this many times that of noise: one axis of a sensor may have up to three times the noise of the others.
LEAST_SPREAD = 9.0
# Standard deviations beyond which a difference is one.
CLEARLY = 3.0
# Numbers of stretches that errors are summed over, and the degrees of freedom that this leaves their spread.
N_STRETCHES = 20
STRETCHES = (40, N_STRETCHES, 10)
# Rounds of judging noise by what remains; and steps at most, where nearly all that begins converges in fewer.
ROUNDS, MOST_STEPS = 3, 50
MEDIAN_TO_SD = 1.4826
ROUNDING = 1e-12  # of a sum of products, far above float64's
SMALLEST_NOISE = 1e-15  # T; exact data would divide by zero


@dataclass(frozen=True, eq=False, slots=True)
class ParameterBlock:
    """A group of unknowns."""

    columns: np.ndarray  # (k, n, 3), T per unit: change of the field per unit of each unknown, survey frame
    sd: float  # prior standard deviation of the unknowns


@dataclass(frozen=True, eq=False, slots=True)
class Solution:
    """Estimates of all blocks."""

    estimate: Mapping[str, np.ndarray]  # each (k,): by block; zero along directions that the data do not determine
    sd: Mapping[str, np.ndarray]  # each (k,): standard deviation, never above the prior's
    p_value: Mapping[str, float]  # probability of an estimate as large if the truth is zero
    is_open: Mapping[str, np.ndarray]  # each (k,): which unknowns the data do not determine
    residual: np.ndarray  # (n, 3), T: what remains of the field's inconsistency
    free: np.ndarray  # (n, 3), T: what would remain if nothing were left at zero: noise, and what no unknown explains
    noise_sd: float  # T: its robust standard deviation per component


@dataclass(frozen=True, eq=False, slots=True)
class System:
    """Blocks and the field to be explained, once projected: any choice of blocks is solved from the same sums."""

    names: tuple[str, ...]  # block of each column; the last column is the field as read
    scale: Scalars  # (k,): expected size of each unknown
    left: np.ndarray  # (k + 1, n, 3), T: projected columns, each scaled by its expected size, the field as read last
    right: np.ndarray  # (k + 1, n, 3), T
    # (k + 1, k + 1): what noise of the readings, per its variance, adds to the products of all these; zero where the
    # columns are free of noise
    noise_products: Matrix

    @classmethod
    def of(
        cls, y: np.ndarray, blocks: Mapping[str, ParameterBlock], project: Projection,
        noise_products: Matrix | None = None,
    ) -> "System":  # fmt: skip
        """Project the field as read, y, and all columns; ``y + sum columns * unknowns`` shall be consistent."""
        names = tuple(name for name, block in blocks.items() for _ in block.columns)
        scale = np.array([block.sd for block in blocks.values() for _ in block.columns])
        columns = np.concatenate([*(block.columns * block.sd for block in blocks.values()), y[None]])
        left, right = project(columns)
        unit = np.append(scale, 1.0)
        by_noise = np.zeros((len(unit), len(unit))) if noise_products is None else noise_products
        return cls(names, scale, left, right, unit[:, None] * by_noise * unit)

    def solve(self, active: Collection[str]) -> Solution:
        """Unknowns of some blocks that make the field most consistent, the others being zero.

        With the columns scaled by the expected sizes, ``H = J' P J / s^2`` has eigenvectors v and values l. Errors
        of the data are correlated along the path, so l is divided by f = v' S v / l, where S sums the outer products
        of the scores of 40, 20 or 10 stretches of the path (a cluster sandwich), whichever is worst, unless f < 1.
        Directions with l / f < 25 are left at zero, and those that noise alone could spread so; along the others the
        estimate is ``-v'g / (l + f)``, with variance ``1 / (1 + l / f)``.
        """
        rows = [i for i, name in enumerate(self.names) if name in active]
        left, right, y = self.left[rows], self.right[rows], self.right[-1]
        if not rows:
            return Solution({}, {}, {}, {}, y, y, robust_sd(y))
        products, against = np.einsum("inc,jnc->ij", left, right), np.einsum("inc,nc->i", left, y)
        values, vectors = np.linalg.eigh((products + products.T) / 2)
        is_seen = values > LEAST_SPREAD * self._noise_along(rows, vectors)
        noise = robust_sd(y)
        # Noise and its correlation are judged by what remains when everything is free: otherwise what is held at zero
        # by mistake would look like noise, and stay there.
        for _ in range(ROUNDS):
            z = -vectors @ np.where(is_seen, (vectors.T @ against) / (np.maximum(values, 0) + noise**2), 0.0)
            free = y + np.einsum("i,inc->nc", z, right)
            noise = robust_sd(free)
        information = np.maximum(values, 0) / noise**2
        inflation = _inflation(left, free, vectors, information, noise)
        is_fixed = is_seen & (information > LEAST_INFORMATION * inflation)
        z = -vectors @ np.where(is_fixed, (vectors.T @ against) / noise**2 / (information + inflation), 0.0)
        residual = y + np.einsum("i,inc->nc", z, right)
        variance = np.where(is_fixed, inflation / (information + inflation), 1.0)
        names = np.array(self.names)[rows]
        return _by_block(names, self.scale[rows], z, (vectors * variance) @ vectors.T, residual, free)

    def _noise_along(self, rows: list[int], vectors: Matrix) -> Scalars:
        """What noise alone adds to the spread along directions of the unknowns, (k,): zero if columns are exact.

        No combination of columns and field varies less than by noise. That of least spread, relative to what noise
        adds to it, therefore tells the noise (total least squares).
        """
        every = [*rows, len(self.names)]
        by_noise = self.noise_products[np.ix_(every, every)]
        if not by_noise.any():
            return np.full(len(rows), -np.inf)  # even a spread below zero, by rounding, is no noise's
        products = np.einsum("inc,jnc->ij", self.left[every], self.right[every])
        # Of readings without noise, or all alike, some combinations have none to solve for.
        by_noise = by_noise + ROUNDING * np.trace(by_noise) * np.eye(len(every))
        variance = eigh((products + products.T) / 2, by_noise, eigvals_only=True, subset_by_index=(0, 0))[0]
        return np.asarray(max(variance, RESOLVED**2) * np.einsum("ik,ij,jk->k", vectors, by_noise[:-1, :-1], vectors))


def _inflation(left: np.ndarray, residual: np.ndarray, vectors: Matrix, values: Scalars, noise: float) -> Scalars:
    """Estimate how many times less the data say along each eigenvector than with independent errors.

    The worst of short and long stretches: steel beside the path correlates errors over metres, drift over laps.
    """
    scores = np.cumsum(np.einsum("inc,nc->ni", left, residual) / noise**2, axis=0) @ vectors
    worst = np.ones(len(values))
    for n_stretches in STRETCHES:
        ends = np.linspace(0, len(residual), n_stretches + 1).astype(np.int64)[1:] - 1
        sums = np.diff(scores[ends], axis=0, prepend=0.0)
        spread = (sums**2).sum(axis=0) * n_stretches / (n_stretches - 1)
        worst = np.maximum(worst, spread / np.maximum(values, 1e-30))
    return worst


def _by_block(
    names: np.ndarray, scale: Scalars, z: Scalars, covariance: Matrix, residual: np.ndarray, free: np.ndarray
) -> Solution:
    """Sort the unknowns by block."""
    estimate, sd, p_value, is_open = {}, {}, {}, {}
    for name in dict.fromkeys(names.tolist()):
        rows = np.flatnonzero(names == name)
        own = covariance[np.ix_(rows, rows)]
        estimate[name] = z[rows] * scale[rows]
        sd[name] = np.sqrt(np.diag(own)) * scale[rows]
        is_open[name] = np.diag(own) > 1 / (1 + LEAST_INFORMATION)
        square = float(z[rows] @ np.linalg.solve(own, z[rows])) / len(rows)
        p_value[name] = float(fdtrc(len(rows), N_STRETCHES - len(rows), square))
    return Solution(estimate, sd, p_value, is_open, residual, free, robust_sd(free))


def robust_sd(residual: np.ndarray) -> float:
    """Standard deviation of a normal variable with the same median size."""
    return max(MEDIAN_TO_SD * float(np.median(np.abs(residual))), SMALLEST_NOISE)
