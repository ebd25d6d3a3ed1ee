# SPDX-License-Identifier: BSD-3-Clause
"""A pose's covariance at the target's position, in the base's axes, as ellipsoids and words.

The covariance of a result is about the target frame's origin, which may be far from the samples; a small rotation is
a large shift there. At the centroid c of the samples ``xi = (theta, rho)`` moves a point by ``R (rho + theta x c)``.
"""

from dataclasses import dataclass

import numpy as np
from scipy.spatial.transform import RigidTransform
from scipy.stats import chi2

from magmatch.geometry import covariance_about, exp_se3, rotation_matrix, transform_points
from magmatch.number_text import told
from magmatch.registration.result import DegenerateDirection
from magmatch.typing import Matrix, Points, Scalars, Vector3

# Share of the probability inside an ellipsoid that is drawn.
LEVEL = 0.95


@dataclass(frozen=True, eq=False, slots=True)
class Ellipsoid:
    """A region that holds the truth with the probability `LEVEL`."""

    half_axes: Scalars  # (3,): longest first, in the unit of the covariance's root
    directions: Matrix  # (3, 3): row k is the unit direction of half axis k, base axes

    def surface(self, n: int = 24) -> Points:
        """Points on it: (n + 1, 2 n + 1, 3), rows from pole to pole."""
        polar, azimuth = np.linspace(0, np.pi, n + 1), np.linspace(0, 2 * np.pi, 2 * n + 1)
        ball = np.stack(
            [
                np.outer(np.sin(polar), np.cos(azimuth)),
                np.outer(np.sin(polar), np.sin(azimuth)),
                np.outer(np.cos(polar), np.ones_like(azimuth)),
            ],
            axis=-1,
        )
        # The longest axis is the pole, so that the rings are drawn across it.
        order = [2, 1, 0]
        return np.asarray((ball * self.half_axes[order]) @ self.directions[order])


def ellipsoids_at(covariance: Matrix, T_base_target: RigidTransform, center: Vector3) -> tuple[Ellipsoid, Ellipsoid]:
    """Ellipsoids of the position of a point of the target (m) and of the target's rotation (rad), in base axes."""
    R, C = rotation_matrix(T_base_target), covariance_about(covariance, np.asarray(center))
    return _ellipsoid(R @ C[3:, 3:] @ R.T), _ellipsoid(R @ C[:3, :3] @ R.T)


def swept(p_target: Points, T_base_target: RigidTransform, free: DegenerateDirection, reach: float) -> Points:
    """Points moved along a free direction of the pose, the farthest by `reach`."""
    theta, rho = free.xi[:3], free.xi[3:]
    longest = float(np.linalg.norm(np.cross(theta, p_target) + rho, axis=1).max())
    return transform_points(p_target, T_base_target * exp_se3(free.xi * (reach / max(longest, 1e-300))))


def length_text(metres: float) -> str:
    """A length in a convenient unit."""
    return f"{1e3 * metres:.3g} mm" if metres < 0.9995 else f"{told(metres, 3, 1.0)} m"


def angle_text(radians: float) -> str:
    """An angle in degrees."""
    return f"{np.rad2deg(radians):.3g} deg"


def direction_words(v: Vector3) -> str:
    """Name a direction of the base: an axis if it is near one, else its components."""
    v = v / np.linalg.norm(v)
    k = int(np.argmax(np.abs(v)))
    if abs(v[k]) > 0.97:
        return f"base {'xyz'[k]}"
    return "({:+.2f}, {:+.2f}, {:+.2f})".format(*(v * np.sign(v[k])))


def _ellipsoid(covariance: Matrix) -> Ellipsoid:
    power, vectors = np.linalg.eigh((covariance + covariance.T) / 2)
    scale = float(np.sqrt(chi2.ppf(LEVEL, 3)))
    return Ellipsoid(scale * np.sqrt(np.maximum(power[::-1], 0)), vectors[:, ::-1].T)
