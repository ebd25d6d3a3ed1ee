# SPDX-License-Identifier: BSD-3-Clause
"""Hypotheses: each an error-state Kalman filter of the body's pose and of what else makes the readings differ.

State: attitude R and position p of the body (model frame), bias b of the sensor (body axes, T), the map's misfit c
along the path (model frame, of unit variance, an Ornstein-Uhlenbeck process as `PathNoise` has it) and the odometry's
scale s. Error: ``R = Exp(theta) R_hat``, the others by their difference; in this order, N in all.
"""

from dataclasses import dataclass, fields
from typing import NamedTuple

import numpy as np

from magmatch.compiled import compiled
from magmatch.localization.config import LocalizerConfig
from magmatch.localization.known_map import KnownMap
from magmatch.slam.graph.pose_graph import LEVEL_SD, UPRIGHT_SD
from magmatch.typing import Matrix, Vector3

THETA, PLACE, BIAS, MISFIT, SCALE, N = 0, 3, 6, 9, 12, 13


class Model(NamedTuple):
    """Numbers of the filter, SI: variances per metre walked (``_walk``) or second, and of a measurement."""

    place_walk: float
    height_walk: float
    turn_walk: float
    tilt_walk: float
    bias_drift: float
    misfit_variance: float
    misfit_length: float
    map_factor2: float
    nugget_variance: float
    gate: float


# A bin that misses by more (chi^2 of 3, one in 10,000) counts as if its covariance were so much larger.
GATE = 21.0


def model_of(known: KnownMap, config: LocalizerConfig) -> Model:
    """Noise as the map's own left-out stretches show it, drift as the odometry's is stated."""
    noise, odometry = known.noise, config.odometry
    # The map's own poses are bent. Its frame is followed as it is: it moves past the body as odometry drifts.
    bent = 2 * noise.drift_sd**2 / noise.drift_length
    turn = odometry.rotation_sd**2
    upright = config.is_gravity_aligned
    return Model(
        place_walk=odometry.translation_sd**2 + bent,
        height_walk=0.0 if config.is_planar else odometry.translation_sd**2 + bent,
        turn_walk=turn,
        # A vertical that gravity gives keeps to it, within the same length as the map's errors last.
        tilt_walk=2 * (0.3 * UPRIGHT_SD) ** 2 / noise.drift_length if upright else turn,
        bias_drift=config.bias_drift**2,
        misfit_variance=noise.misfit_sd**2 + noise.constant_sd**2,
        misfit_length=noise.misfit_length,
        map_factor2=noise.map_factor**2,
        nugget_variance=noise.nugget_sd**2,
        gate=GATE,
    )


@dataclass(frozen=True, eq=False, slots=True)
class Bank:
    """Hypotheses side by side: R (k, 3, 3), p, b, c (k, 3), s (k,), P (k, N, N)."""

    R: np.ndarray
    p: np.ndarray
    b: np.ndarray
    c: np.ndarray
    s: np.ndarray
    P: np.ndarray

    @classmethod
    def empty(cls, n: int) -> "Bank":
        """Room for n hypotheses."""
        p, b, c = np.zeros((3, n, 3))
        return cls(np.tile(np.eye(3), (n, 1, 1)), p, b, c, np.zeros(n), np.tile(np.eye(N), (n, 1, 1)))

    def rows(self, chosen: np.ndarray) -> "Bank":
        """Copies of some."""
        return Bank(*(np.ascontiguousarray(getattr(self, f.name)[chosen]) for f in fields(self)))

    def joined(self, other: "Bank") -> "Bank":
        """These, then others."""
        return Bank(*(np.concatenate([getattr(one, f.name) for one in (self, other)]) for f in fields(self)))


def start_covariance(up: Vector3, sd: tuple[float, float], config: LocalizerConfig) -> Matrix:
    """Of poses from a search, known to sd (m, rad); the bias is left at 0."""
    vertical = np.outer(up, up)
    level = np.eye(3) - vertical
    tilt = UPRIGHT_SD if config.is_gravity_aligned else sd[1]
    height = LEVEL_SD if config.is_planar else sd[0]
    P = np.zeros((N, N))
    P[:3, :3] = sd[1] ** 2 * vertical + tilt**2 * level
    P[3:6, 3:6] = sd[0] ** 2 * level + height**2 * vertical
    P[MISFIT:SCALE, MISFIT:SCALE] = np.eye(3)
    P[SCALE, SCALE] = config.odometry.scale_sd**2
    return P


@compiled
def predict(k, R, p, c, s, P, dR, u, dt, up, model):  # type: ignore[no-untyped-def]
    """Move hypothesis k on by odometry: turn dR and shift u in the axes of the body before it."""
    d = np.sqrt(u[0] ** 2 + u[1] ** 2 + u[2] ** 2)
    f = 1 + s[k]
    wx = R[k, 0, 0] * u[0] + R[k, 0, 1] * u[1] + R[k, 0, 2] * u[2]
    wy = R[k, 1, 0] * u[0] + R[k, 1, 1] * u[1] + R[k, 1, 2] * u[2]
    wz = R[k, 2, 0] * u[0] + R[k, 2, 1] * u[1] + R[k, 2, 2] * u[2]
    fade = np.exp(-d / model.misfit_length)
    p[k, 0] += f * wx
    p[k, 1] += f * wy
    p[k, 2] += f * wz
    for a in range(3):
        c[k, a] *= fade
    # P = F P F^T, rows then columns: a turn theta carries the step with it, theta x (f w).
    for j in range(N):
        tx, ty, tz, ds = P[k, 0, j], P[k, 1, j], P[k, 2, j], P[k, SCALE, j]
        P[k, 3, j] += f * (ty * wz - tz * wy) + wx * ds
        P[k, 4, j] += f * (tz * wx - tx * wz) + wy * ds
        P[k, 5, j] += f * (tx * wy - ty * wx) + wz * ds
        for a in range(MISFIT, SCALE):
            P[k, a, j] *= fade
    for i in range(N):
        tx, ty, tz, ds = P[k, i, 0], P[k, i, 1], P[k, i, 2], P[k, i, SCALE]
        P[k, i, 3] += f * (ty * wz - tz * wy) + wx * ds
        P[k, i, 4] += f * (tz * wx - tx * wz) + wy * ds
        P[k, i, 5] += f * (tx * wy - ty * wx) + wz * ds
        for a in range(MISFIT, SCALE):
            P[k, i, a] *= fade
    for a in range(3):
        P[k, a, a] += model.tilt_walk * d
        P[k, 3 + a, 3 + a] += model.place_walk * d
        P[k, BIAS + a, BIAS + a] += model.bias_drift * dt
        P[k, MISFIT + a, MISFIT + a] += 1 - fade * fade
        for e in range(3):
            vertical = up[a] * up[e] * d
            P[k, a, e] += (model.turn_walk - model.tilt_walk) * vertical
            P[k, 3 + a, 3 + e] += (model.height_walk - model.place_walk) * vertical
    for a in range(3):
        x, y, z = R[k, a, 0], R[k, a, 1], R[k, a, 2]
        for e in range(3):
            R[k, a, e] = x * dR[0, e] + y * dR[1, e] + z * dR[2, e]


@compiled
def correct(k, R, p, b, c, s, dx):  # type: ignore[no-untyped-def]
    """Add an error to hypothesis k: ``R = Exp(theta) R``."""
    for a in range(3):
        p[k, a] += dx[PLACE + a]
        b[k, a] += dx[BIAS + a]
        c[k, a] += dx[MISFIT + a]
    s[k] += dx[SCALE]
    angle = np.sqrt(dx[0] ** 2 + dx[1] ** 2 + dx[2] ** 2)
    if angle > 0:
        x, y, z = dx[0] / angle, dx[1] / angle, dx[2] / angle
        sine, cosine = np.sin(angle), np.cos(angle)
        for e in range(3):
            # Rodrigues' formula on each column.
            rx, ry, rz = R[k, 0, e], R[k, 1, e], R[k, 2, e]
            along = (1 - cosine) * (x * rx + y * ry + z * rz)
            R[k, 0, e] = cosine * rx + sine * (y * rz - z * ry) + along * x
            R[k, 1, e] = cosine * ry + sine * (z * rx - x * rz) + along * y
            R[k, 2, e] = cosine * rz + sine * (x * ry - y * rx) + along * z
