# SPDX-License-Identifier: BSD-3-Clause
"""Hypotheses: each an error-state Kalman filter of the body's pose and of what else makes the readings differ.

State: attitude R and position p of the body (model frame), bias b of the sensor (body axes, T) and its gain, the
map's misfit c along the path (model frame, of unit variance, an Ornstein-Uhlenbeck or Matern-3/2 process as
`PathNoise` has it), the map's own error e (the same, always Matern-3/2), the slopes of both and the odometry's scale.
Error: ``R = Exp(theta) R_hat``, the others by their difference; N in all, of which a reading depends on the first.
"""

from typing import NamedTuple

import numpy as np

from magmatch.compiled import compiled, inlined
from magmatch.localization.config import LocalizerConfig
from magmatch.localization.known_map import KnownMap
from magmatch.preparation.odometry.drift import LEVEL_SD, UPRIGHT_SD
from magmatch.typing import ROTATION, VECTOR, Matrix, Vector3

PLACE, BIAS, MISFIT, ERROR, GAIN = range(3, 18, 3)
N_READ = MISFIT_SLOPE = GAIN + 1
ERROR_SLOPE, SCALE, N = MISFIT_SLOPE + 3, MISFIT_SLOPE + 6, MISFIT_SLOPE + 7
# One hypothesis; a bank is an array of them. Gain and scale: what they differ from 1 by. Earlier: nats that the
# search for it cost, and that bins gained that are no longer kept. Drift: of the variances that the odometry's random
# walk is stated with, the factor under which this hypothesis follows it.
HYPOTHESIS = np.dtype([
    ("R", ROTATION), ("p", VECTOR), ("b", VECTOR), ("c", VECTOR), ("e", VECTOR), ("c_slope", VECTOR),
    ("e_slope", VECTOR), ("gain", "f8"), ("scale", "f8"), ("P", "f8", (N, N)), ("earlier", "f8"), ("drift", "f8"),
])  # fmt: skip
# A bin that misses by more (chi^2 of 3, one in 10,000) counts as if its covariance were so much larger.
GATE = 21.0
# Rate of the Matern-3/2 process whose correlation falls to a half where a squared exponential's of length 1 does.
RATE = 1.67835 / np.sqrt(2 * np.log(2))


class Model(NamedTuple):
    """Numbers of the filter, SI: variances per metre walked (``_walk``) or second, and of a measurement."""

    place_walk: float  # of the odometry, as stated
    turn_walk: float
    bent_walk: float  # of the map's own poses
    tilt_walk: float  # 0: as much as the turn
    is_planar: bool
    bias_drift: float
    misfit_variance: float
    misfit_length: float
    misfit_is_smooth: bool
    map_factor2: float
    error_rate: float
    nugget_variance: float
    gate: float


def model_of(known: KnownMap, config: LocalizerConfig) -> Model:
    """Noise as the map's own left-out stretches show it, drift as the odometry's is stated."""
    noise, odometry = known.noise, config.odometry
    # The map's own poses are bent. Its frame is followed as it is: it moves past the body as odometry drifts.
    bent = 2 * noise.drift_sd**2 / noise.drift_length
    return Model(
        place_walk=odometry.translation_sd**2,
        turn_walk=odometry.rotation_sd**2,
        bent_walk=bent,
        # A vertical that gravity gives keeps to it, within the same length as the map's errors last.
        tilt_walk=2 * (0.3 * UPRIGHT_SD) ** 2 / noise.drift_length if config.is_gravity_aligned else 0.0,
        is_planar=config.is_planar,
        bias_drift=config.bias_drift**2,
        misfit_variance=noise.misfit_sd**2 + noise.constant_sd**2,
        misfit_length=noise.misfit_length,
        misfit_is_smooth=noise.is_smooth,
        map_factor2=noise.map_factor**2,
        error_rate=RATE / noise.map_length,
        nugget_variance=noise.nugget_sd**2,
        gate=GATE,
    )


def hypotheses(n: int) -> np.ndarray:
    """Make a bank of n, all at the model's origin."""
    bank = np.zeros(n, HYPOTHESIS)
    bank["R"], bank["P"], bank["drift"] = np.eye(3), np.eye(N), 1.0
    return bank


def start_covariance(up: Vector3, sd: tuple[float, float], config: LocalizerConfig) -> Matrix:
    """Give the covariance of poses from a search, known to sd (m, rad); the bias is left at 0."""
    vertical = np.outer(up, up)
    level = np.eye(3) - vertical
    tilt = UPRIGHT_SD if config.is_gravity_aligned else sd[1]
    height = LEVEL_SD if config.is_planar else sd[0]
    P = np.zeros((N, N))
    P[:3, :3] = sd[1] ** 2 * vertical + tilt**2 * level
    P[3:6, 3:6] = sd[0] ** 2 * level + height**2 * vertical
    P[MISFIT:SCALE, MISFIT:SCALE] = np.eye(SCALE - MISFIT)
    P[GAIN, GAIN] = config.gain_sd**2
    P[SCALE, SCALE] = config.odometry.scale_sd**2
    return P


@inlined
def transition(v):  # type: ignore[no-untyped-def]
    """Give how value and slope of a Matern-3/2 process depend on both a path of rate times length v before.

    The slope is over its rate, and of the value's variance; f00, f01, f10, f11.
    """
    e = np.exp(-v)
    return e * (1 + v), e * v, -e * v, e * (1 - v)


@inlined
def transition_of(is_smooth, x):  # type: ignore[no-untyped-def]
    """Give the transition over so many lengthscales; a rough one is Ornstein-Uhlenbeck, without slope."""
    if is_smooth:
        return transition(np.sqrt(3.0) * x)
    return np.exp(-x), 0.0, 0.0, 0.0


@compiled
def predict(h, dR, u, dt, up, model):  # type: ignore[no-untyped-def]
    """Move a hypothesis on by odometry: turn dR and shift u in the axes of the body before it."""
    R, p, c, e, c_slope, e_slope, P = h.R, h.p, h.c, h.e, h.c_slope, h.e_slope, h.P
    d = np.sqrt(u[0] ** 2 + u[1] ** 2 + u[2] ** 2)
    f = 1 + h.scale
    wx = R[0, 0] * u[0] + R[0, 1] * u[1] + R[0, 2] * u[2]
    wy = R[1, 0] * u[0] + R[1, 1] * u[1] + R[1, 2] * u[2]
    wz = R[2, 0] * u[0] + R[2, 1] * u[1] + R[2, 2] * u[2]
    m00, m01, m10, m11 = transition_of(model.misfit_is_smooth, d / model.misfit_length)
    f00, f01, f10, f11 = transition(model.error_rate * d)
    p[0] += f * wx
    p[1] += f * wy
    p[2] += f * wz
    for a in range(3):
        c[a], c_slope[a] = m00 * c[a] + m01 * c_slope[a], m10 * c[a] + m11 * c_slope[a]
        e[a], e_slope[a] = f00 * e[a] + f01 * e_slope[a], f10 * e[a] + f11 * e_slope[a]
    # P = F P F^T: F P, then F (F P)^T in place of its transpose.
    _times_F(P, f, wx, wy, wz, m00, m01, m10, m11, f00, f01, f10, f11)
    _times_F(P.T, f, wx, wy, wz, m00, m01, m10, m11, f00, f01, f10, f11)
    # Of a stationary process as much comes back as the step forgets.
    g00, g01, g11 = 1 - f00 * f00 - f01 * f01, -f00 * f10 - f01 * f11, 1 - f10 * f10 - f11 * f11
    n00, n01, n11 = 1 - m00 * m00 - m01 * m01, -m00 * m10 - m01 * m11, 1 - m10 * m10 - m11 * m11
    turn, place = h.drift * model.turn_walk, h.drift * model.place_walk + model.bent_walk
    tilt, height = model.tilt_walk if model.tilt_walk > 0 else turn, 0.0 if model.is_planar else place
    for a in range(3):
        P[a, a] += tilt * d
        P[3 + a, 3 + a] += place * d
        P[BIAS + a, BIAS + a] += model.bias_drift * dt
        P[MISFIT + a, MISFIT + a] += n00
        P[MISFIT_SLOPE + a, MISFIT_SLOPE + a] += n11
        P[MISFIT + a, MISFIT_SLOPE + a] += n01
        P[MISFIT_SLOPE + a, MISFIT + a] += n01
        P[ERROR + a, ERROR + a] += g00
        P[ERROR_SLOPE + a, ERROR_SLOPE + a] += g11
        P[ERROR + a, ERROR_SLOPE + a] += g01
        P[ERROR_SLOPE + a, ERROR + a] += g01
        for k in range(3):
            vertical = up[a] * up[k] * d
            P[a, k] += (turn - tilt) * vertical
            P[3 + a, 3 + k] += (height - place) * vertical
    for a in range(3):
        x, y, z = R[a, 0], R[a, 1], R[a, 2]
        for k in range(3):
            R[a, k] = x * dR[0, k] + y * dR[1, k] + z * dR[2, k]


@compiled
def _times_F(P, f, wx, wy, wz, m00, m01, m10, m11, f00, f01, f10, f11):  # type: ignore[no-untyped-def]
    """F P, for the step w in the model's axes: a turn theta carries the step with it, theta x (f w)."""
    for j in range(N):
        tx, ty, tz, ds = P[0, j], P[1, j], P[2, j], P[SCALE, j]
        P[3, j] += f * (ty * wz - tz * wy) + wx * ds
        P[4, j] += f * (tz * wx - tx * wz) + wy * ds
        P[5, j] += f * (tx * wy - ty * wx) + wz * ds
        for a in range(3):
            x, v = P[MISFIT + a, j], P[MISFIT_SLOPE + a, j]
            P[MISFIT + a, j], P[MISFIT_SLOPE + a, j] = m00 * x + m01 * v, m10 * x + m11 * v
            x, v = P[ERROR + a, j], P[ERROR_SLOPE + a, j]
            P[ERROR + a, j], P[ERROR_SLOPE + a, j] = f00 * x + f01 * v, f10 * x + f11 * v


@compiled
def correct(h, dx):  # type: ignore[no-untyped-def]
    """Add an error to a hypothesis: ``R = Exp(theta) R``."""
    R, p, b, c, e, c_slope, e_slope = h.R, h.p, h.b, h.c, h.e, h.c_slope, h.e_slope
    for a in range(3):
        p[a] += dx[PLACE + a]
        b[a] += dx[BIAS + a]
        c[a] += dx[MISFIT + a]
        e[a] += dx[ERROR + a]
        c_slope[a] += dx[MISFIT_SLOPE + a]
        e_slope[a] += dx[ERROR_SLOPE + a]
    h.gain += dx[GAIN]
    h.scale += dx[SCALE]
    angle = np.sqrt(dx[0] ** 2 + dx[1] ** 2 + dx[2] ** 2)
    if angle > 0:
        x, y, z = dx[0] / angle, dx[1] / angle, dx[2] / angle
        sine, cosine = np.sin(angle), np.cos(angle)
        for k in range(3):
            # Rodrigues' formula on each column.
            rx, ry, rz = R[0, k], R[1, k], R[2, k]
            along = (1 - cosine) * (x * rx + y * ry + z * rz)
            R[0, k] = cosine * rx + sine * (y * rz - z * ry) + along * x
            R[1, k] = cosine * ry + sine * (z * rx - x * rz) + along * y
            R[2, k] = cosine * rz + sine * (x * ry - y * rx) + along * z


@compiled
def settle(P, PH, S, r, gate, dx):  # type: ignore[no-untyped-def]
    """Take any filter's covariance P on by a reading of innovation r; what the state changes by goes to dx.

    `PH` is P H^T, and S (upper half) the innovation's covariance. An innovation whose chi^2 exceeds the gate counts
    as if S were so much larger. Gives chi^2 and half the log-determinant.
    """
    # Inverse of a symmetric matrix of three by its cofactors.
    c00, c01 = S[1, 1] * S[2, 2] - S[1, 2] * S[1, 2], S[0, 2] * S[1, 2] - S[0, 1] * S[2, 2]
    c02, c11 = S[0, 1] * S[1, 2] - S[0, 2] * S[1, 1], S[0, 0] * S[2, 2] - S[0, 2] * S[0, 2]
    c12, c22 = S[0, 1] * S[0, 2] - S[0, 0] * S[1, 2], S[0, 0] * S[1, 1] - S[0, 1] * S[0, 1]
    det = S[0, 0] * c00 + S[0, 1] * c01 + S[0, 2] * c02
    chi2 = (
        r[0] * (c00 * r[0] + c01 * r[1] + c02 * r[2])
        + r[1] * (c01 * r[0] + c11 * r[1] + c12 * r[2])
        + r[2] * (c02 * r[0] + c12 * r[1] + c22 * r[2])
    ) / det
    factor = max(chi2 / gate, 1.0)
    scale = 1 / (det * factor)
    for i in range(len(dx)):
        x, y, w = PH[i, 0] * scale, PH[i, 1] * scale, PH[i, 2] * scale
        k0, k1, k2 = x * c00 + y * c01 + w * c02, x * c01 + y * c11 + w * c12, x * c02 + y * c12 + w * c22
        dx[i] = k0 * r[0] + k1 * r[1] + k2 * r[2]
        for j in range(i + 1):
            P[i, j] -= k0 * PH[j, 0] + k1 * PH[j, 1] + k2 * PH[j, 2]
            P[j, i] = P[i, j]
    return chi2 / factor, 0.5 * np.log(det) + 1.5 * np.log(factor)
