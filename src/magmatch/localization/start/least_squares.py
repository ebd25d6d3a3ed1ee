# SPDX-License-Identifier: BSD-3-Clause
"""Place, heading, scale and bias of a stretch of path in a map, by Gauss-Newton steps from many starts.

Residuals in the model's axes, ``T f - T R b - B(x + (1 + s) T q)``, T the turn about the vertical; Student weights of
six degrees of freedom.
"""

from typing import NamedTuple

import numpy as np

from magmatch.compiled import allocating, compiled
from magmatch.localization.start.grid_score import OUTSIDE, UNKNOWN
from magmatch.registration.prepared.raster import find_cell, interpolate
from magmatch.typing import ROTATION, VECTOR

# A bin in axes with the map's up: shift from the last bin (m), field (T), attitude.
STRETCH = np.dtype([("q", VECTOR), ("f", VECTOR), ("R", ROTATION)])


class Priors(NamedTuple):
    """Standard deviations: bias (T), scale, height (m); and the field length (m)."""

    bias_sd: float
    scale_sd: float
    height_sd: float
    length: float


@allocating
def refine_all(x, stretch, ground, schedule, priors, cost):  # type: ignore[no-untyped-def]
    """Gauss-Newton on rows of x: place (3), heading, scale, bias (3); their costs, UNKNOWN outside the map."""
    A, v, T = np.zeros((8, 8)), np.zeros(8), np.zeros((3, 3))
    # Of one bin: what was looked up, slopes, vectors.
    room = np.zeros(13), np.zeros((3, 8)), np.zeros(3), np.zeros(3), np.zeros(3), np.zeros(3)
    for k in range(len(x)):
        h0 = ground.up[0] * x[k, 0] + ground.up[1] * x[k, 1] + ground.up[2] * x[k, 2]
        for step in range(len(schedule) + 1):
            sd2 = schedule[min(step, len(schedule) - 1)] ** 2
            total, n_known = _linearise(x[k], stretch, ground, h0, sd2, priors, A, v, T, room)
            cost[k] = total if n_known > 0 else UNKNOWN
            if step == len(schedule):
                break
            _solve(A, v)
            longest = np.sqrt(v[0] ** 2 + v[1] ** 2 + v[2] ** 2) / (0.3 * priors.length)
            shorten = 1 / max(1.0, longest, abs(v[3]) / 0.15)
            for i in range(8):
                x[k, i] -= shorten * v[i]


@compiled
def _linearise(x, stretch, ground, h0, sd2, priors, A, v, T, room):  # type: ignore[no-untyped-def]
    """Normal equations of one start; its cost, and the number of bins that the map knows."""
    A[:], v[:] = 0.0, 0.0
    _turn_about(ground.up, np.cos(x[3]), np.sin(x[3]), T)
    total = _add_priors(x, ground.up, h0, priors, A, v)
    n_known = 0
    for m in range(len(stretch)):
        added = _add_bin(x, stretch[m], ground, sd2, A, v, T, room)
        total += added
        n_known += added != OUTSIDE
    return total, n_known


@compiled
def _add_priors(x, up, h0, priors, A, v):  # type: ignore[no-untyped-def]
    bias_sd, scale_sd, height_sd, length = priors
    off = up[0] * x[0] + up[1] * x[1] + up[2] * x[2] - h0
    total = (off / height_sd) ** 2 + (x[4] / scale_sd) ** 2
    for a in range(3):
        # Loose, so that a direction without a slope stays where it is.
        A[a, a] += 1 / (1.5 * length) ** 2
        v[a] += up[a] * off / height_sd**2
        for b in range(3):
            A[a, b] += up[a] * up[b] / height_sd**2
        A[5 + a, 5 + a] += 1 / bias_sd**2
        v[5 + a] += x[5 + a] / bias_sd**2
        total += (x[5 + a] / bias_sd) ** 2
    A[3, 3] += 1 / 0.3**2
    A[4, 4] += 1 / scale_sd**2
    v[4] += x[4] / scale_sd**2
    return total


@compiled
def _add_bin(x, one, ground, sd2, A, v, T, room):  # type: ignore[no-untyped-def]
    out, J, turned, place, reading, e = room
    q, f, R, up, stretch = one.q, one.f, one.R, ground.up, 1 + x[4]
    for a in range(3):
        turned[a] = T[a, 0] * q[0] + T[a, 1] * q[1] + T[a, 2] * q[2]
        place[a] = x[a] + stretch * turned[a]
        reading[a] = T[a, 0] * f[0] + T[a, 1] * f[1] + T[a, 2] * f[2]
    i, j, n, s, t, w = find_cell(ground.values, ground.origin, ground.spacing, place[0], place[1], place[2])
    if i < 0:
        return OUTSIDE
    interpolate(ground.values, ground.spacing, i, j, n, s, t, w, out)
    e2 = 0.0
    for a in range(3):
        # A turn about the vertical carries the place and turns the reading.
        b, c = (a + 1) % 3, (a + 2) % 3
        J[a, 3] = up[b] * reading[c] - up[c] * reading[b]
        e[a], J[a, 4] = reading[a] - out[a], 0.0
        for d in range(3):
            g, h = (d + 1) % 3, (d + 2) % 3
            slope = -out[4 + 3 * a + d]
            J[a, d] = slope
            J[a, 3] += slope * stretch * (up[g] * turned[h] - up[h] * turned[g])
            J[a, 4] += slope * turned[d]
            J[a, 5 + d] = -(T[a, 0] * R[0, d] + T[a, 1] * R[1, d] + T[a, 2] * R[2, d])
            e[a] += J[a, 5 + d] * x[5 + d]
        e2 += e[a] ** 2 / sd2
    weight = 1 / (1 + e2 / 6) / sd2
    for i in range(8):
        for a in range(3):
            v[i] += weight * J[a, i] * e[a]
            for j in range(i + 1):
                A[i, j] += weight * J[a, i] * J[a, j]
    return 6 * np.log(1 + e2 / 6)


@compiled
def _turn_about(up, cosine, sine, T):  # type: ignore[no-untyped-def]
    for a in range(3):
        for b in range(3):
            T[a, b] = (1 - cosine) * up[a] * up[b]
        T[a, a] += cosine
    T[0, 1] -= sine * up[2]
    T[1, 0] += sine * up[2]
    T[0, 2] += sine * up[1]
    T[2, 0] -= sine * up[1]
    T[1, 2] -= sine * up[0]
    T[2, 1] += sine * up[0]


@compiled
def _solve(A, v):  # type: ignore[no-untyped-def]
    """Solve A x = v in place by Cholesky's factor; the lower half of A counts."""
    n = len(v)
    for j in range(n):
        for i in range(j, n):
            total = A[i, j]
            for m in range(j):
                total -= A[i, m] * A[j, m]
            A[i, j] = np.sqrt(total) if i == j else total / A[j, j]
    for i in range(n):
        for m in range(i):
            v[i] -= A[i, m] * v[m]
        v[i] /= A[i, i]
    for i in range(n - 1, -1, -1):
        for m in range(i + 1, n):
            v[i] -= A[m, i] * v[m]
        v[i] /= A[i, i]
