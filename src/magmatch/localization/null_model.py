# SPDX-License-Identifier: BSD-3-Clause
"""The field along the path as a smooth random field of its own: what a hypothesis has to beat.

A bank of Kalman filters along the path, in the odometry's axes: per component a Matern-3/2 field of some lengthscale
and strength, the same misfit and nugget that a hypothesis may plead, and a constant; the sensor's bias beside them.
The most likely of them counts.
"""

from itertools import product

import numpy as np

from magmatch.compiled import compiled
from magmatch.localization.config import LocalizerConfig
from magmatch.localization.known_map import KnownMap
from magmatch.localization.measurement import Fit, Steps
from magmatch.localization.state import Model

# Lengthscales, in field lengths, and strengths, in the map's standard deviation.
LENGTHSCALES, STRENGTHS = (0.6, 1.2, 2.4), (0.25, 0.5, 1.0, 2.0)
FIELD, SLOPE, MISFIT, CONSTANT, BIAS, N = 0, 1, 2, 3, 12, 15


class NullModel:
    """Unrelated fields, each filtered up to the last bin: those of the whole path, and the same begun anew."""

    def __init__(self, known: KnownMap, model: Model, config: LocalizerConfig) -> None:
        noise = known.noise
        numbers = list(product(LENGTHSCALES, STRENGTHS, (config.calibrated_bias_sd, config.bias_sd)))
        self._kinds = np.array([(np.sqrt(3) / (a * known.length), (b * known.field_sd) ** 2) for a, b, _ in numbers])
        turned = 2 * known.field_rms**2 * noise.attitude_sd**2
        self._misfit = model.misfit_variance + turned, model.misfit_length
        self._model = model
        self._start = np.zeros((len(numbers), N, N))
        for P, (_, variance), (*_, bias) in zip(self._start, self._kinds, numbers, strict=True):
            alike = [variance, variance, self._misfit[0], known.field_rms**2]
            np.fill_diagonal(P, [*alike, *alike, *alike, *[bias**2] * 3])
        self._x, self._P = np.zeros((len(numbers), N)), self._start.copy()

    def begin_anew(self, steps: Steps, fit: Fit) -> Fit:
        """Let unrelated fields begin with the last of the bins of a fit, too: where a body is carried to."""
        n, before = len(self._start), fit.chi2.shape[1] - len(steps)
        kept, kinds = (self._x[:n], self._P[:n]), self._kinds[:n]
        self._kinds, self._x, self._P = kinds, np.zeros_like(kept[0]), self._start.copy()
        anew = fit.rows(np.arange(n)).columns(slice(before)).then(self.follow(steps))
        self._kinds = np.concatenate([kinds, kinds])
        self._x, self._P = (np.concatenate([old, new]) for old, new in zip(kept, (self._x, self._P), strict=True))
        return fit.rows(np.arange(n)).joined(anew)

    def follow(self, steps: Steps) -> Fit:
        """Take all through some bins, as `measurement.follow` does hypotheses."""
        fit = Fit.empty(len(self._x), len(steps))
        fit.is_known[:] = True
        step = np.sqrt((steps.u**2).sum(axis=1))
        _follow(
            step, steps.dt, np.einsum("nij,nj->ni", steps.R, steps.z), steps.R @ steps.M,
            self._kinds, *self._misfit, self._model.nugget_variance, self._model.bias_drift, self._model.gate,
            self._x, self._P, fit.chi2, fit.half_log_det,
        )  # fmt: skip
        return fit


@compiled
def _follow(  # type: ignore[no-untyped-def]
    d, dt, b, RM, kinds, misfit, misfit_length, nugget, bias_drift, gate, x, P, chi2, half_log_det
):
    PH, S, C = np.zeros((N, 3)), np.zeros((3, 3)), np.zeros((3, 3))
    r = np.zeros(3)
    for k in range(len(x)):
        for n in range(len(d)):
            _predict(k, x, P, d[n], dt[n], kinds[k, 0], kinds[k, 1], misfit, misfit_length, bias_drift)
            for i in range(N):
                for a in range(3):
                    at = 4 * a
                    total = P[k, i, at] + P[k, i, at + MISFIT] + P[k, i, at + CONSTANT]
                    for e in range(3):
                        total += P[k, i, BIAS + e] * RM[n, a, e]
                    PH[i, a] = total
            for a in range(3):
                at = 4 * a
                r[a] = b[n, a] - x[k, at] - x[k, at + MISFIT] - x[k, at + CONSTANT]
                for e in range(3):
                    r[a] -= RM[n, a, e] * x[k, BIAS + e]
                    S[a, e] = PH[at, e] + PH[at + MISFIT, e] + PH[at + CONSTANT, e]
                    for f in range(3):
                        S[a, e] += RM[n, a, f] * PH[BIAS + f, e]
                S[a, a] += nugget
            C[0, 0], C[0, 1] = S[1, 1] * S[2, 2] - S[1, 2] ** 2, S[0, 2] * S[1, 2] - S[0, 1] * S[2, 2]
            C[0, 2], C[1, 1] = S[0, 1] * S[1, 2] - S[0, 2] * S[1, 1], S[0, 0] * S[2, 2] - S[0, 2] ** 2
            C[1, 2], C[2, 2] = S[0, 1] * S[0, 2] - S[0, 0] * S[1, 2], S[0, 0] * S[1, 1] - S[0, 1] ** 2
            C[1, 0], C[2, 0], C[2, 1] = C[0, 1], C[0, 2], C[1, 2]
            det = S[0, 0] * C[0, 0] + S[0, 1] * C[0, 1] + S[0, 2] * C[0, 2]
            found = 0.0
            for a in range(3):
                for e in range(3):
                    found += r[a] * C[a, e] * r[e] / det
            factor = max(found / gate, 1.0)
            chi2[k, n], half_log_det[k, n] = found / factor, 0.5 * np.log(det) + 1.5 * np.log(factor)
            for i in range(N):
                k0 = (PH[i, 0] * C[0, 0] + PH[i, 1] * C[1, 0] + PH[i, 2] * C[2, 0]) / (det * factor)
                k1 = (PH[i, 0] * C[0, 1] + PH[i, 1] * C[1, 1] + PH[i, 2] * C[2, 1]) / (det * factor)
                k2 = (PH[i, 0] * C[0, 2] + PH[i, 1] * C[1, 2] + PH[i, 2] * C[2, 2]) / (det * factor)
                x[k, i] += k0 * r[0] + k1 * r[1] + k2 * r[2]
                for j in range(i + 1):
                    P[k, i, j] -= k0 * PH[j, 0] + k1 * PH[j, 1] + k2 * PH[j, 2]
                    P[k, j, i] = P[k, i, j]


@compiled
def _predict(k, x, P, d, dt, rate, variance, misfit, misfit_length, bias_drift):  # type: ignore[no-untyped-def]
    """Along d metres of path; the slope is in units of the field, times the rate."""
    v = rate * d
    e, fade = np.exp(-v), np.exp(-d / misfit_length)
    f00, f01, f10, f11 = e * (1 + v), e * v, -e * v, e * (1 - v)
    for a in range(3):
        i = 4 * a
        x[k, i], x[k, i + SLOPE] = f00 * x[k, i] + f01 * x[k, i + 1], f10 * x[k, i] + f11 * x[k, i + 1]
        x[k, i + MISFIT] *= fade
        for j in range(N):
            P[k, i, j], P[k, i + 1, j] = (
                f00 * P[k, i, j] + f01 * P[k, i + 1, j],
                f10 * P[k, i, j] + f11 * P[k, i + 1, j],
            )
            P[k, i + MISFIT, j] *= fade
    for a in range(3):
        j = 4 * a
        for i in range(N):
            P[k, i, j], P[k, i, j + 1] = (
                f00 * P[k, i, j] + f01 * P[k, i, j + 1],
                f10 * P[k, i, j] + f11 * P[k, i, j + 1],
            )
            P[k, i, j + MISFIT] *= fade
        # Stationary: what the step forgets comes back as noise.
        P[k, j, j] += variance * (1 - f00 * f00 - f01 * f01)
        P[k, j + 1, j + 1] += variance * (1 - f10 * f10 - f11 * f11)
        P[k, j, j + 1] -= variance * (f00 * f10 + f01 * f11)
        P[k, j + 1, j] -= variance * (f00 * f10 + f01 * f11)
        P[k, j + MISFIT, j + MISFIT] += misfit * (1 - fade * fade)
        P[k, BIAS + a, BIAS + a] += bias_drift * dt
