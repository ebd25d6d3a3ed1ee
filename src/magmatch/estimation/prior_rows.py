# SPDX-License-Identifier: BSD-3-Clause
"""A pose prior speaks of many poses: compiled loops add information, gradient and chi^2, or rule out."""

import numpy as np

from magmatch.compiled import compiled


@compiled
def add_vertical(R, up_base, up_target, sd, A, v, chi2):  # type: ignore[no-untyped-def]
    """Add that the target's vertical is the base's, to a standard deviation (rad)."""
    w = 1 / sd**2
    for p in range(len(R)):
        s = _turned_back(R[p], up_base)
        x, y, z = s
        off = up_target[0] - x, up_target[1] - y, up_target[2] - z
        # J = -[s]x, so that J^T J = s^2 - s s^T and J^T off = s x off.
        s2 = x * x + y * y + z * z
        for a in range(3):
            A[p, a, a] += s2 * w
            for b in range(3):
                A[p, a, b] -= s[a] * s[b] * w
        v[p, 0] += (y * off[2] - z * off[1]) * w
        v[p, 1] += (z * off[0] - x * off[2]) * w
        v[p, 2] += (x * off[1] - y * off[0]) * w
        chi2[p] += (off[0] ** 2 + off[1] ** 2 + off[2] ** 2) * w


@compiled
def add_height(R, moved, up_base, height, sd, A, v, chi2):  # type: ignore[no-untyped-def]
    """Add that the target's middle lies at a height (m) of the base, to a standard deviation (m)."""
    w = 1 / sd**2
    for p in range(len(R)):
        s = _turned_back(R[p], up_base)
        off = moved[p, 0] * up_base[0] + moved[p, 1] * up_base[1] + moved[p, 2] * up_base[2] - height
        for a in range(3):
            for b in range(3):
                A[p, 3 + a, 3 + b] += s[a] * s[b] * w
            v[p, 3 + a] += s[a] * off * w
        chi2[p] += off**2 * w


@compiled
def add_pose(R, moved, R0, p0, information, A, v, chi2, J, PJ, r, D):  # type: ignore[no-untyped-def]
    """Add a rough pose, that turns by R0 and puts the target's middle at p0, with its information (6, 6)."""
    for p in range(len(R)):
        _apart(R[p], moved[p], R0, p0, D, r)
        _fill_slopes(D, r, J)
        for a in range(6):
            pulled = 0.0
            for c in range(6):
                pulled += information[a, c] * r[c]
                PJ[a, c] = 0.0
                for d in range(6):
                    PJ[a, c] += information[a, d] * J[d, c]
            chi2[p] += r[a] * pulled
            for b in range(6):
                v[p, b] += pulled * J[a, b]
        for a in range(6):
            for b in range(6):
                for c in range(6):
                    A[p, a, b] += J[c, a] * PJ[c, b]


@compiled
def rule_out_far(R, moved, R0, p0, wide, far2, is_admitted, r, D):  # type: ignore[no-untyped-def]
    """Rule out poses whose turn or shift is too far from a rough one's, by their information (2, 3, 3)."""
    for p in range(len(R)):
        if is_admitted[p]:
            _apart(R[p], moved[p], R0, p0, D, r)
            for k in range(2):
                off2 = 0.0
                for a in range(3):
                    for b in range(3):
                        off2 += r[3 * k + a] * wide[k, a, b] * r[3 * k + b]
                is_admitted[p] = is_admitted[p] and off2 < far2


@compiled
def _apart(R, moved, R0, p0, D, r):  # type: ignore[no-untyped-def]
    """Fill in how a pose is off the rough one, in its axes: the turn D; in r that turn and the shift."""
    for a in range(3):
        r[3 + a] = 0.0
        for b in range(3):
            r[3 + a] += (moved[b] - p0[b]) * R0[b, a]
            D[a, b] = 0.0
            for c in range(3):
                D[a, b] += R0[c, a] * R[c, b]
    _rotation_vector(D, r)


@compiled
def _fill_slopes(D, r, J):  # type: ignore[no-untyped-def]
    """Slopes of r: those of ``log(D Exp(theta))`` to first order in the angle already there."""
    for a in range(6):
        for b in range(6):
            J[a, b] = 1.0 if a == b else 0.0
    for a in range(3):
        for b in range(3):
            J[3 + a, 3 + b] = D[a, b]
    J[0, 1], J[0, 2], J[1, 2] = -0.5 * r[2], 0.5 * r[1], -0.5 * r[0]
    J[1, 0], J[2, 0], J[2, 1] = 0.5 * r[2], -0.5 * r[1], 0.5 * r[0]


@compiled
def _turned_back(R, u):  # type: ignore[no-untyped-def]
    """``R^T u``."""
    return (
        R[0, 0] * u[0] + R[1, 0] * u[1] + R[2, 0] * u[2],
        R[0, 1] * u[0] + R[1, 1] * u[1] + R[2, 1] * u[2],
        R[0, 2] * u[0] + R[1, 2] * u[1] + R[2, 2] * u[2],
    )


@compiled
def _rotation_vector(R, r):  # type: ignore[no-untyped-def]
    """Rotation vector of R, by its quaternion, whose largest entry is found first (S. Shepperd, JGCD 1(3), 1978)."""
    t = R[0, 0] + R[1, 1] + R[2, 2]
    k = 0 if R[0, 0] >= R[1, 1] and R[0, 0] >= R[2, 2] else (1 if R[1, 1] >= R[2, 2] else 2)
    i, j = (k + 1) % 3, (k + 2) % 3
    if t >= R[k, k]:
        w = 1 + t
        r[0], r[1], r[2] = R[2, 1] - R[1, 2], R[0, 2] - R[2, 0], R[1, 0] - R[0, 1]
    else:
        w = R[j, i] - R[i, j]
        r[k], r[i], r[j] = 1 + 2 * R[k, k] - t, R[i, k] + R[k, i], R[j, k] + R[k, j]
    length = np.sqrt(r[0] ** 2 + r[1] ** 2 + r[2] ** 2)
    # The shorter way round; no turn has no axis.
    if w < 0:
        w, r[0], r[1], r[2] = -w, -r[0], -r[1], -r[2]
    scale = 2 * np.arctan2(length, w) / length if length > 0 else 0.0
    r[0], r[1], r[2] = r[0] * scale, r[1] * scale, r[2] * scale
