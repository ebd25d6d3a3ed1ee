# SPDX-License-Identifier: BSD-3-Clause
"""Kernels of vector fields made from the Gaussian, and their derivatives, as products of 1-D Hermite functions.

Every derivative of ``exp(-|d|^2 / 2 l^2)`` is a product of one function per axis, so a kernel that is a linear
differential operator on it is a short list of terms. The same list gives kernel matrices, their derivatives, and
fast evaluation on grids (`gaussian_grid`).
"""

from collections.abc import Callable
from dataclasses import dataclass
from functools import cache
from itertools import permutations, product

import numpy as np

from magmatch.typing import Matrix, Points

# How often each axis is differentiated.
Alpha = tuple[int, int, int]
# Rows per point up to order 0, 1, 2: field; gradient, row-major; second derivatives, row-major.
N_ROWS = (3, 12, 39)
# exp(-t^2/2) is zero in float64 at this t.
_FAR = 40.0


@dataclass(frozen=True, slots=True)
class Term:
    """One term of a differential operator that makes a field of scalar Gaussians."""

    component: int  # which component of the field comes from which weight of a node
    weight: int
    alpha: Alpha  # (int, int, int): how often each axis is differentiated
    factor: float  # coefficient, for derivatives taken with respect to ``d / l``


@dataclass(frozen=True, slots=True)
class Target:
    """The target of one product of Hermite functions: row of the point, weight of the node, coefficient."""

    row: int
    weight: int
    factor: float
    n_derivatives: int


def _alpha(axes: tuple[int, ...]) -> Alpha:
    return axes.count(0), axes.count(1), axes.count(2)


# ``l^2/2 (grad grad^T - I lap)``: the divergence-free operator, scaled to unit variance. On the diagonal d_a d_a -
# lap leaves minus the other two second derivatives. With ``d = x - x'`` the kernel is
# ``K(x, x') = sf^2/l^2 exp(-|d|^2/2l^2) [(d/l)(d/l)^T + (2 - |d|^2/l^2) I]``, and ``signal_sd^2 = 2 sf^2/l^2``.
# Wahlström, Kok, Schön, Gustafsson (2013), Modeling magnetic fields using Gaussian processes,
# doi:10.1109/ICASSP.2013.6638313.
DIVERGENCE_FREE = tuple(
    term
    for a, b in permutations(range(3), 2)
    for term in (Term(a, b, _alpha((a, b)), 0.5), Term(a, a, _alpha((b, b)), -0.5))
)
# ``-l^2 grad grad^T``: covariance of the gradient of a Gaussian potential, scaled to unit variance. The kernel is
# ``K(x, x') = sf^2/l^2 exp(-|d|^2/2l^2) [I - (d/l)(d/l)^T]``, and ``signal_sd = sf / l``.
# Solin, Kok, Wahlström, Schön, Särkkä (2018), Modeling and interpolation of the ambient magnetic field by Gaussian
# processes, doi:10.1109/TRO.2018.2830326.
CURL_FREE = tuple(Term(a, b, _alpha((a, b)), -1.0) for a, b in product(range(3), repeat=2))
# ``-l grad``: the field of a potential that is itself the weights' Gaussian, one weight per node.
GRADIENT = tuple(Term(a, 0, _alpha((a,)), -1.0) for a in range(3))


@cache
def derivative_plan(terms: tuple[Term, ...], order: int) -> tuple[tuple[Alpha, tuple[Target, ...]], ...]:
    """Every product of Hermite functions that field and derivatives need, and where each one goes."""
    if order not in (0, 1, 2):
        msg = f"expected order 0 (field), 1 (and gradient) or 2 (and second derivatives), got {order}"
        raise ValueError(msg)
    plan: dict[Alpha, list[Target]] = {}
    first_row = 0
    for n in range(order + 1):
        for term in terms:
            for place, axes in enumerate(product(range(3), repeat=n)):
                extra = _alpha(axes)
                alpha = (term.alpha[0] + extra[0], term.alpha[1] + extra[1], term.alpha[2] + extra[2])
                row = first_row + term.component * 3**n + place
                plan.setdefault(alpha, []).append(Target(row, term.weight, term.factor, n))
        first_row = N_ROWS[n]
    return tuple((alpha, tuple(targets)) for alpha, targets in sorted(plan.items()))


def highest_derivative(terms: tuple[Term, ...], order: int) -> int:
    """How often a single axis is differentiated at most."""
    return max(max(term.alpha) for term in terms) + order


def weights_per_node(terms: tuple[Term, ...]) -> int:
    """How many weights a node has: 1 for a potential, 3 for a field."""
    return 1 + max(term.weight for term in terms)


def hermite_functions(t: np.ndarray, highest: int) -> np.ndarray:
    """Derivatives of ``exp(-t^2/2)``."""
    # Zero from here on in float64; squares of absurd distances would overflow.
    t = np.clip(t, -_FAR, _FAR)
    out = np.empty((highest + 1, *t.shape))
    np.exp(-0.5 * t * t, out=out[0])
    if highest >= 1:
        np.multiply(-t, out[0], out=out[1])
    for k in range(1, highest):
        out[k + 1] = -t * out[k] - k * out[k - 1]
    return out


def stack_products(
    product_of: Callable[[Alpha], Matrix],
    terms: tuple[Term, ...],
    order: int,
    lengthscale: float,
    shape: tuple[int, int],
) -> np.ndarray:
    """Matrix of field and derivatives at points against weights of nodes, for a kernel of unit variance."""
    n, m = shape
    plan = derivative_plan(terms, order)
    out = np.zeros((N_ROWS[order], n, weights_per_node(terms), m))
    for alpha, targets in plan:
        values = product_of(alpha)
        for target in targets:
            out[target.row, :, target.weight] += (target.factor / lengthscale**target.n_derivatives) * values
    return out


@dataclass(frozen=True, slots=True)
class Kernel:
    """A second-order differential operator on the squared exponential."""

    terms: tuple[Term, ...]  # `DIVERGENCE_FREE` or `CURL_FREE`
    lengthscale: float  # m: l
    signal_sd: float = 1.0  # T: prior standard deviation of one component

    def __post_init__(self) -> None:
        if not (0 < self.lengthscale < np.inf and 0 < self.signal_sd < np.inf):
            msg = f"expected positive lengthscale and signal_sd, got {self.lengthscale} m and {self.signal_sd} T"
            raise ValueError(msg)

    def covariance(self, points: Points, others: Points, order: int = 0) -> Matrix:
        """Covariance of field (and derivatives) at points with the field at others: (rows n, 3 m), by component."""
        highest = highest_derivative(self.terms, order)
        offsets = ((points[:, None, k] - others[None, :, k]) / self.lengthscale for k in range(3))
        x, y, z = (hermite_functions(t, highest) for t in offsets)
        shape = (len(points), len(others))
        stacked = stack_products(
            lambda alpha: x[alpha[0]] * y[alpha[1]] * z[alpha[2]], self.terms, order, self.lengthscale, shape
        )
        stacked *= self.signal_sd**2
        return stacked.reshape(N_ROWS[order] * shape[0], 3 * shape[1])

    def at_one_point(self, order: int = 0) -> Matrix:
        """Prior covariance of field (order 0: (3, 3)) or field and gradient (order 1: (12, 12)) at one point."""
        origin = np.zeros((1, 3))
        rows = self.covariance(origin, origin, 2 * order)
        if order == 0:
            return rows
        out = np.zeros((12, 12))
        out[:3, :3] = rows[:3]
        # Differentiating with respect to x' changes the sign: cov(d_b B_a, d'_d B_c) = -d_b d_d K_ac(0).
        second = rows[12:].reshape(3, 3, 3, 3)
        out[3:, 3:] = -second.transpose(0, 1, 3, 2).reshape(9, 9)
        return out
