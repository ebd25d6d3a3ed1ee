# SPDX-License-Identifier: BSD-3-Clause
"""The measurement update of hypotheses by a bin of samples: ``z = gain R^T (B(p) + g c + s e) + M b + nugget``.

g^2 is the variance of the field that does not repeat from walk to walk, s^2 that of the map's own error.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from magmatch.compiled import allocating, compiled
from magmatch.localization.bins import STEP
from magmatch.localization.known_map import KnownMap
from magmatch.localization.state import BIAS, ERROR, GAIN, MISFIT, N_READ, PLACE, Model, N, correct, predict, settle
from magmatch.registration.prepared.raster import find_cell, interpolate

# How well a hypothesis predicted a bin: chi^2, half its log-determinant; whether the map knows the place; whether the
# bin was predicted at all.
FIT = np.dtype([("chi2", "f8"), ("half_log_det", "f8"), ("is_known", "i8"), ("is_seen", "i8")])


@dataclass(eq=False, slots=True)
class LatestBins:
    """The last bins, and how well hypotheses (k) and unrelated fields (c) predicted each."""

    steps: np.ndarray  # (n,) of STEP
    fit: np.ndarray  # (n, k) of FIT
    null: np.ndarray  # (n, c) of FIT

    @classmethod
    def of(cls, n_null: int) -> "LatestBins":
        """Begin without a bin."""
        return cls(np.zeros(0, STEP), np.zeros((0, 0), FIT), np.zeros((0, n_null), FIT))

    def __len__(self) -> int:
        return len(self.steps)

    def __getitem__(self, rows: slice) -> "LatestBins":
        return LatestBins(self.steps[rows], self.fit[rows], self.null[rows])

    def add(self, new: np.ndarray) -> None:
        """Place a bin, (1,) of STEP, behind the others; its predictions are still to be written."""
        last = self.steps[-1] if len(self) else new[0]
        self.steps = np.concatenate([self.steps, new])
        self.fit, self.null = (
            np.concatenate([part, np.zeros((1, part.shape[1]), FIT)]) for part in (self.fit, self.null)
        )
        one, R0 = self.steps[-1], last["R"]
        u = R0.T @ (one["p"] - last["p"])
        one["dR"], one["u"], one["dt"] = R0.T @ one["R"], u, one["t"] - last["t"]
        one["walked"] = last["walked"] + math.sqrt(u @ u)

    def keep(self, rows: Sequence[int]) -> None:
        """Keep some hypotheses."""
        self.fit = np.ascontiguousarray(self.fit[:, rows])

    def join(self, fit: np.ndarray) -> None:
        """Join more hypotheses, which fared so in the last bins."""
        before = np.zeros((len(self) - len(fit), fit.shape[1]), FIT)
        self.fit = np.concatenate([self.fit, np.concatenate([before, fit])], axis=1)


def follow(
    bank: np.ndarray, known: KnownMap, model: Model, steps: np.ndarray, fit: np.ndarray, *, moves_first: bool
) -> None:
    """Take hypotheses ``bank`` (k,) through some bins, changing them; writes the FIT of each, (n, k).

    ``moves_first``: the odometry that leads to the first bin counts.
    """
    _follow(bank, steps, moves_first, known.ground, model, fit)


@allocating
def _follow(bank, steps, moves_first, ground, model, fit):  # type: ignore[no-untyped-def]
    out, H, PH, S, r, dx = (
        np.zeros(13),
        np.zeros((3, N)),
        np.zeros((N, 3)),
        np.zeros((3, 3)),
        np.zeros(3),
        np.zeros(N),
    )
    for k in range(len(bank)):
        h = bank[k]
        for n in range(len(steps)):
            step, found = steps[n], fit[n, k]
            if n > 0 or moves_first:
                predict(h, step.dR, step.u, step.dt, ground.up, model)
            i, j, m, x, y, w = find_cell(ground.values, ground.origin, ground.spacing, h.p[0], h.p[1], h.p[2])
            found.is_seen, found.is_known = 1, i >= 0
            if i >= 0:
                interpolate(ground.values, ground.spacing, i, j, m, x, y, w, out)
                _linearise(h, step, out, model, H, r)
                _spread(h.P, H, model.nugget_variance, PH, S)
                found.chi2, found.half_log_det = settle(h.P, PH, S, r, model.gate, dx)
                correct(h, dx)


@compiled
def _linearise(h, step, out, model, H, r):  # type: ignore[no-untyped-def]
    """Innovation and its derivatives where the map's field, sd and gradient are `out`."""
    R, f = h.R, 1 + h.gain
    g, s = np.sqrt(model.misfit_variance), np.sqrt(model.map_factor2) * out[3]
    bx, by, bz = (
        out[0] + g * h.c[0] + s * h.e[0],
        out[1] + g * h.c[1] + s * h.e[1],
        out[2] + g * h.c[2] + s * h.e[2],
    )
    for a in range(3):
        x, y, w = R[0, a], R[1, a], R[2, a]
        reading = x * bx + y * by + w * bz
        r[a] = step.z[a] - f * reading
        # R^T [B]x, R^T G, M, g R^T, s R^T and the reading itself.
        H[a, 0], H[a, 1], H[a, 2] = f * (y * bz - w * by), f * (w * bx - x * bz), f * (x * by - y * bx)
        for e in range(3):
            H[a, PLACE + e] = f * (x * out[4 + e] + y * out[7 + e] + w * out[10 + e])
            H[a, BIAS + e] = step.M[a, e]
            r[a] -= step.M[a, e] * h.b[e]
        H[a, MISFIT], H[a, MISFIT + 1], H[a, MISFIT + 2] = f * g * x, f * g * y, f * g * w
        H[a, ERROR], H[a, ERROR + 1], H[a, ERROR + 2] = f * s * x, f * s * y, f * s * w
        H[a, GAIN] = reading


@compiled
def _spread(P, H, nugget, PH, S):  # type: ignore[no-untyped-def]
    """P H^T and H P H^T + nugget (upper half); slopes and the odometry's scale enter no reading."""
    for i in range(N):
        for a in range(3):
            total = 0.0
            for j in range(N_READ):
                total += P[i, j] * H[a, j]
            PH[i, a] = total
    for a in range(3):
        for e in range(a, 3):
            total = nugget if a == e else 0.0
            for j in range(N_READ):
                total += H[a, j] * PH[j, e]
            S[a, e] = total
