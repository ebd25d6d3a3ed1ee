# SPDX-License-Identifier: BSD-3-Clause
"""The null model of a walk: its field is unrelated to the base's."""

import dataclasses
from dataclasses import dataclass
from itertools import product

import numpy as np
from scipy.linalg import cholesky, solve_triangular

from magmatch.registration.prepared.cubes import FEW_POINTS, even_choice
from magmatch.registration.prepared.path_noise import PathNoise
from magmatch.registration.prepared.walk import Walk
from magmatch.typing import Mask, Matrix, Vector3, Vectors

# Tried lengthscales (in correlation lengths) and strengths (in the walk's own standard deviation).
LENGTHSCALES = (0.55, 0.8, 1.2, 1.7, 2.6)
STRENGTHS = (0.0, *np.exp2(range(-1, 3)))


@dataclass(frozen=True, eq=False, slots=True)
class UnrelatedWalk:
    """The walk's field as an independent smooth random field: the null model of a pose.

    It includes the walk's own errors, and their variation between walks, as a pose does; otherwise a rough walk would
    match any calm region.
    """

    field: Vectors  # (n, 3), T: minus the mean that it has at any place
    covariance: Matrix  # (n, n), T^2: of each component
    noise: PathNoise
    favour: float  # nats: gain in likelihood because its parameters are chosen on the walk itself
    # Log likelihoods of the bins that were asked for
    _found: dict[bytes, float] = dataclasses.field(default_factory=dict, init=False, repr=False)

    @classmethod
    def most_likely(
        cls,
        walk: Walk,
        distance: Matrix,
        noise: PathNoise,
        length: float,
        around: tuple[Vector3, float] | None = None,
    ) -> "UnrelatedWalk":
        """Try lengthscales and strengths: the most likely ones make its covariance, all of them its likelihood.

        ``around``: mean of the field wherever the walk may be (T), walk's axes, and variance of a component about it
        (T^2): where the heading is known, Earth's field speaks for no place. Without it, any mean is as likely.
        """
        some = even_choice(len(walk), FEW_POINTS)
        d2 = distance[np.ix_(some, some)] ** 2
        spread2 = float(walk.field.var(axis=0).mean()) + noise.nugget_sd**2
        square = float((walk.field**2).sum(axis=1).mean()) / 3
        mean, constant = around or (np.zeros(3), square)
        field = walk.field - mean
        errors = noise.isotropic(distance, np.zeros(len(walk)))
        errors = errors + 2 * square * noise.attitude_sd**2 * np.exp(-distance / noise.drift_length)
        tried = [(f * length, s**2 * spread2) for f, s in product(LENGTHSCALES, STRENGTHS)]
        few, errors_of_few = field[some], errors[np.ix_(some, some)]
        found = np.array([
            _log_likelihood(few, _covariance(d2, *numbers, constant) + errors_of_few, noise) for numbers in tried
        ])  # fmt: skip
        chosen = tried[int(found.argmax())]
        # Its parameters are unknown: the evidence is averaged over them, including those of calm places.
        favour = float(found.max() - np.logaddexp.reduce(found) + np.log(len(found)))
        return cls(field, _covariance(distance**2, *chosen, constant) + errors, noise, favour)

    def log_likelihood(self, rows: Mask) -> float:
        """Log density of some bins' field (the factor of 2 pi left out)."""
        asked = rows.tobytes()
        if asked not in self._found:
            covariance = self.covariance[np.ix_(rows, rows)]
            self._found[asked] = _log_likelihood(self.field[rows], covariance, self.noise) - self.favour
        return self._found[asked]


def _covariance(d2: Matrix, length: float, variance: float, constant: float) -> Matrix:
    # Rational quadratic: a mixture of lengthscales, as the field of sources at many distances is.
    K: Matrix = variance / (1 + d2 / (2 * length**2)) + constant
    return K


def _log_likelihood(values: Vectors, K: Matrix, noise: PathNoise) -> float:
    L = cholesky(K, lower=True, check_finite=False, overwrite_a=True)
    z = solve_triangular(L, values, lower=True, check_finite=False)
    log_likelihood = noise.factor(np.array((z**2).sum()), np.array(3 * len(L)))[1]
    return float(log_likelihood) - float(3 * np.log(np.diag(L)).sum())
