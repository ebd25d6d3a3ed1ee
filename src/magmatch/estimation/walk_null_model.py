# SPDX-License-Identifier: BSD-3-Clause
"""The null model of a walk: its field is unrelated to the base's."""

import dataclasses
from dataclasses import dataclass
from itertools import product

import numpy as np

from magmatch.estimation.cubes import even_choice
from magmatch.estimation.limits import FEW_POINTS
from magmatch.estimation.map_null_model import rational_quadratic
from magmatch.estimation.path_noise import PathNoise
from magmatch.estimation.walk import Walk
from magmatch.estimation.walk_rows import whiten
from magmatch.typing import Indices, Mask, Matrix, Scalars, Vector3, Vectors

# Tried lengthscales (in correlation lengths) and strengths (in the standard deviation of the bins asked for).
LENGTHSCALES = (0.55, 0.8, 1.2, 1.7, 2.6)
STRENGTHS = (0.0, *np.exp2(range(-1, 3)))


@dataclass(frozen=True, eq=False, slots=True)
class UnrelatedWalk:
    """The walk's field as an independent smooth random field: the null model of a pose.

    It includes the walk's own errors, and their variation between walks, as a pose does; otherwise a rough walk would
    match any calm region.
    """

    walk: Walk
    noise: PathNoise
    length: float  # m: correlation length
    # (vector, float): mean of the field wherever the walk may be (T), walk's axes, and variance of a component about
    # it (T^2): where the heading is known, Earth's field speaks for no place. Without it, any mean is as likely.
    around: tuple[Vector3, float] | None = None
    # (k, n, 3, n, 3), T^2: covariances by how the walk's orientations may drift, each as likely
    turned: np.ndarray | None = None
    # Log likelihoods of the bins that were asked for
    _found: dict[bytes, float] = dataclasses.field(default_factory=dict, init=False, repr=False)

    def log_likelihood(self, rows: Mask) -> float:
        """Log density of some bins' field (the factor of 2 pi left out), as of a walk that has no others.

        Bins that a pose leaves out say nothing of those that it explains: a calm part is as calm beside a rough one.
        """
        asked = rows.tobytes()
        if asked not in self._found:
            self._found[asked] = self._averaged(np.flatnonzero(rows))
        return self._found[asked]

    def _averaged(self, rows: Indices) -> float:
        """Average over lengthscales and strengths, those of calm places too, and over how orientations drift."""
        field = self.walk.field[rows]
        spread2 = float(field.var(axis=0).mean()) + self.noise.nugget_sd**2
        square = float((field**2).sum(axis=1).mean()) / 3
        mean, constant = self.around or (np.zeros(3), square)
        distance = self.walk.distance[np.ix_(rows, rows)]
        errors = self.noise.isotropic(distance, np.zeros(len(rows))) + constant
        errors += 2 * square * self.noise.attitude_sd**2 * np.exp(-distance / self.noise.drift_length)

        def average(turned: np.ndarray | None, n_some: int) -> float:
            """Average for orientations that are true, or that drift; a few bins tell what is most likely."""
            scales = product(LENGTHSCALES, STRENGTHS, range(1 if turned is None else len(turned)))
            tried = np.array([(f * self.length, s**2 * spread2, k) for f, s, k in scales])

            def log_likelihoods(at: Indices, tried: Matrix) -> Scalars:
                length, variance, _ = tried.T[:, :, None, None]
                K = rational_quadratic(distance[np.ix_(at, at)] ** 2, length, variance) + errors[np.ix_(at, at)]
                values = field[at] - mean
                if turned is not None:
                    C = turned[:, rows[at]][:, :, :, rows[at]][tried[:, 2].astype(np.int64)]
                    for i in range(3):
                        C[:, :, i, :, i] += K
                    K, values = C.reshape(len(C), values.size, values.size), values.reshape(-1, 1)
                return _log_likelihoods(values, K, self.noise)

            found = log_likelihoods(even_choice(len(rows), n_some), tried)
            most_likely = tried[[int(found.argmax())]]
            favour = float(found.max() - np.logaddexp.reduce(found) + np.log(len(found)))
            return float(log_likelihoods(np.arange(len(rows)), most_likely)[0]) - favour

        alike = average(None, FEW_POINTS)
        if self.turned is None:
            return alike
        return float(np.logaddexp(alike, average(self.turned, FEW_POINTS // 3)) - np.log(2))


def _log_likelihoods(values: Vectors, K: np.ndarray, noise: PathNoise) -> Scalars:
    """Give the log-likelihoods of values (n, c) under each of several covariances (t, n, n) of each column."""
    L = np.linalg.cholesky(K)
    z = whiten(L, np.broadcast_to(values, (len(L), *values.shape)))
    half_log_det = values.shape[1] * np.log(np.diagonal(L, axis1=1, axis2=2)).sum(axis=1)
    log_likelihood = noise.factor((z**2).sum(axis=(1, 2)), np.full(len(L), values.size))[1]
    return np.asarray(log_likelihood - half_log_det)
