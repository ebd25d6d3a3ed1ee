# SPDX-License-Identifier: BSD-3-Clause
"""The null model: the field along the path is an independent smooth random field.

A bank of Kalman filters along the path, in the odometry's axes: per component a Matern-3/2 field of some lengthscale
and strength, misfit and nugget as in a hypothesis or less, and a constant; in addition the sensor's bias. All are
equally probable beforehand.
"""

from itertools import product

import numpy as np

from magmatch.compiled import allocating, compiled
from magmatch.localization.config import LocalizerConfig
from magmatch.localization.known_map import KnownMap
from magmatch.localization.measurement import FIT
from magmatch.localization.state import Model, settle, transition
from magmatch.typing import Vector3

# Lengthscales, in field lengths, and strengths, in the map's standard deviation.
LENGTHSCALES, STRENGTHS = (0.7, 2.0), (0.25, 0.7, 2.0)
# Misfit and nugget, in the hypotheses' standard deviations: another place may be smoother than a poor map's errors.
NOISES = (1.0, 0.3)
FIELD, SLOPE, MISFIT, CONSTANT, PER_AXIS = range(5)
BIAS, N = 3 * PER_AXIS, 3 * PER_AXIS + 3
# One unrelated field: its lengthscale's rate (1/m), variances (T^2), its filter's state and covariance.
UNRELATED = np.dtype(
    [("rate", "f8"), ("variance", "f8"), ("misfit", "f8"), ("nugget", "f8"), ("x", "f8", N), ("P", "f8", (N, N))]
)


class UnrelatedFields:
    """Unrelated fields, each filtered up to the last bin: those of the whole path, and the same begun anew.

    All that changes is `now`.
    """

    def __init__(self, known: KnownMap, model: Model, config: LocalizerConfig) -> None:
        # A field turned by the errors of orientations varies, too.
        turned = 2 * known.field_rms**2 * known.noise.attitude_sd**2
        # A smooth misfit is nothing that an unrelated field, smooth itself, lacks.
        rough = turned if model.misfit_is_smooth else turned + model.misfit_variance
        self._model = model
        kinds = list(product(LENGTHSCALES, STRENGTHS, NOISES, known.bias_sds(config)))
        self._start = np.zeros(len(kinds), UNRELATED)
        mean, variances = _constant_elsewhere(known, config)
        for one, (lengthscale, strength, noise, bias) in zip(self._start, kinds, strict=True):
            one["rate"], one["variance"] = np.sqrt(3) / (lengthscale * known.length), (strength * known.field_sd) ** 2
            one["misfit"] = noise**2 * rough
            one["nugget"] = noise**2 * model.nugget_variance
            one["x"][CONSTANT:BIAS:PER_AXIS] = mean
            alike = [one["variance"], one["variance"], one["misfit"]]
            np.fill_diagonal(one["P"], [x for v in variances for x in (*alike, v)] + 3 * [bias**2])
        self.now = self._start.copy()

    def begin_anew(self, steps: np.ndarray, fit: np.ndarray) -> np.ndarray:
        """Let unrelated fields begin with the last of the bins of a fit, too: where a body is carried to."""
        n = len(self._start)
        fit = np.concatenate([fit[:, :n], fit[:, :n]], axis=1)
        kept, self.now = self.now[:n], self._start.copy()
        anew = np.zeros((len(steps), n), FIT)
        self.follow(steps, anew)
        fit[len(fit) - len(steps) :, n:] = anew
        self.now = np.concatenate([kept, self.now])
        return fit

    def follow(self, steps: np.ndarray, fit: np.ndarray) -> None:
        """Take all through some bins, as `measurement.follow` does hypotheses."""
        _follow(self.now, steps, self._model, fit)


def _constant_elsewhere(known: KnownMap, config: LocalizerConfig) -> tuple[Vector3, Vector3]:
    """Mean and variances of another place's constant, in the odometry's axes: the Earth's field, of any heading."""
    square, vertical = float(known.mean_field @ known.mean_field), float(known.mean_field @ known.up)
    if not config.is_gravity_aligned:
        return np.zeros(3), np.full(3, square / 3 + known.field_sd**2)
    level = (square - vertical**2) / 2
    return np.array([0.0, 0.0, vertical]), np.array([level, level, 0.0]) + known.field_sd**2


@allocating
def _follow(nulls, steps, model, fit):  # type: ignore[no-untyped-def]
    PH, S, RM = np.zeros((N, 3)), np.zeros((3, 3)), np.zeros((3, 3))
    b, r, dx = np.zeros(3), np.zeros(3), np.zeros(N)
    for n in range(len(steps)):
        R, M, z, u = steps[n].R, steps[n].M, steps[n].z, steps[n].u
        d = np.sqrt(u[0] ** 2 + u[1] ** 2 + u[2] ** 2)
        for a in range(3):
            b[a] = R[a, 0] * z[0] + R[a, 1] * z[1] + R[a, 2] * z[2]
            for e in range(3):
                RM[a, e] = R[a, 0] * M[0, e] + R[a, 1] * M[1, e] + R[a, 2] * M[2, e]
        for k in range(len(nulls)):
            one, found = nulls[k], fit[n, k]
            _predict(one, d, steps[n].dt, model)
            _compare(one, b, RM, PH, S, r)
            found.is_seen, found.is_known = 1, 1
            found.chi2, found.half_log_det = settle(one.P, PH, S, r, model.gate, dx)
            for i in range(N):
                one.x[i] += dx[i]


@compiled
def _compare(one, b, RM, PH, S, r):  # type: ignore[no-untyped-def]
    """Innovation by a field b in the odometry's axes, P H^T and the innovation's covariance (upper half)."""
    x, P = one.x, one.P
    for i in range(N):
        for a in range(3):
            at = PER_AXIS * a
            total = P[i, at] + P[i, at + MISFIT] + P[i, at + CONSTANT]
            for e in range(3):
                total += P[i, BIAS + e] * RM[a, e]
            PH[i, a] = total
    for a in range(3):
        at = PER_AXIS * a
        r[a] = b[a] - x[at] - x[at + MISFIT] - x[at + CONSTANT]
        for e in range(3):
            r[a] -= RM[a, e] * x[BIAS + e]
            S[a, e] = PH[at, e] + PH[at + MISFIT, e] + PH[at + CONSTANT, e]
            for f in range(3):
                S[a, e] += RM[a, f] * PH[BIAS + f, e]
        S[a, a] += one.nugget


@compiled
def _predict(one, d, dt, model):  # type: ignore[no-untyped-def]
    """Predict along d metres of path; the slope is in units of the field, times the rate."""
    x, P, variance, fade = one.x, one.P, one.variance, np.exp(-d / model.misfit_length)
    f00, f01, f10, f11 = transition(one.rate * d)
    for a in range(3):
        i = PER_AXIS * a
        x[i], x[i + SLOPE] = f00 * x[i] + f01 * x[i + 1], f10 * x[i] + f11 * x[i + 1]
        x[i + MISFIT] *= fade
        for j in range(N):
            P[i, j], P[i + 1, j] = f00 * P[i, j] + f01 * P[i + 1, j], f10 * P[i, j] + f11 * P[i + 1, j]
            P[i + MISFIT, j] *= fade
    for a in range(3):
        j = PER_AXIS * a
        for i in range(N):
            P[i, j], P[i, j + 1] = f00 * P[i, j] + f01 * P[i, j + 1], f10 * P[i, j] + f11 * P[i, j + 1]
            P[i, j + MISFIT] *= fade
        # Stationary: what the step forgets comes back as noise.
        P[j, j] += variance * (1 - f00 * f00 - f01 * f01)
        P[j + 1, j + 1] += variance * (1 - f10 * f10 - f11 * f11)
        P[j, j + 1] -= variance * (f00 * f10 + f01 * f11)
        P[j + 1, j] -= variance * (f00 * f10 + f01 * f11)
        P[j + MISFIT, j + MISFIT] += one.misfit * (1 - fade * fade)
        P[BIAS + a, BIAS + a] += model.bias_drift * dt
