# SPDX-License-Identifier: BSD-3-Clause
"""Magnetic sources and their field, by magpylib behind one function."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from types import ModuleType
from typing import Any

import numpy as np
from scipy.spatial.transform import Rotation

from magmatch.errors import import_extra
from magmatch.typing import Matrix, Points, Scalars, Vector3, Vectors

# Source-point pairs evaluated at once: bounds memory at some 100 MB however long a survey is.
_PAIRS_AT_ONCE = 400_000


@dataclass(frozen=True, eq=False, slots=True)
class Cuboid:
    """A uniformly magnetised cuboid: a block magnet, or a steel cabinet seen as one."""

    center: Vector3  # (3,), m: world frame
    size: Vector3  # (3,), m: full sides along the body's axes
    polarization: Vector3  # (3,), T: magnetic polarisation J = mu0 M, body frame
    rotation: Rotation  # takes body coordinates to world coordinates

    def distance_to(self, points: Points) -> Scalars:
        """Distance of points to the surface; zero inside it."""
        return _outside(np.abs((points - self.center) @ self.rotation.as_matrix()) - self.size / 2)

    def strengthened(self, factor: float) -> "Cuboid":
        """Return the same body, its magnetisation multiplied."""
        return replace(self, polarization=self.polarization * factor)

    def in_magpylib(self, magpylib: ModuleType) -> Any:
        """Magpylib's counterpart (SI units on both sides)."""
        return magpylib.magnet.Cuboid(
            position=self.center, orientation=self.rotation, polarization=self.polarization, dimension=self.size
        )


@dataclass(frozen=True, eq=False, slots=True)
class Cylinder:
    """A uniformly magnetised cylinder along its body's z: a pipe, a can, a disc magnet."""

    center: Vector3  # (3,), m: world frame
    diameter: float  # m: across and along the body's z
    height: float  # m
    polarization: Vector3  # (3,), T: magnetic polarisation J = mu0 M, body frame
    rotation: Rotation  # takes body coordinates to world coordinates

    def distance_to(self, points: Points) -> Scalars:
        """Distance of points to the surface; zero inside it."""
        local = (points - self.center) @ self.rotation.as_matrix()
        radial = np.hypot(local[:, 0], local[:, 1]) - self.diameter / 2
        return _outside(np.column_stack([radial, np.abs(local[:, 2]) - self.height / 2]))

    def strengthened(self, factor: float) -> "Cylinder":
        """Return the same body, its magnetisation multiplied."""
        return replace(self, polarization=self.polarization * factor)

    def in_magpylib(self, magpylib: ModuleType) -> Any:
        """Magpylib's counterpart (SI units on both sides)."""
        return magpylib.magnet.Cylinder(
            position=self.center, orientation=self.rotation, polarization=self.polarization,
            dimension=(self.diameter, self.height),
        )  # fmt: skip


@dataclass(frozen=True, eq=False, slots=True)
class Dipole:
    """A point dipole: anything small against its distance."""

    center: Vector3  # (3,), m: world frame
    moment: Vector3  # (3,), A m^2: world frame

    def distance_to(self, points: Points) -> Scalars:
        """Distance of points to it."""
        return np.asarray(np.linalg.norm(points - self.center, axis=1))

    def strengthened(self, factor: float) -> "Dipole":
        """Return the same dipole, its moment multiplied."""
        return replace(self, moment=self.moment * factor)

    def in_magpylib(self, magpylib: ModuleType) -> Any:
        """Magpylib's counterpart (SI units on both sides)."""
        return magpylib.misc.Dipole(position=self.center, moment=self.moment)


Source = Cuboid | Cylinder | Dipole


def field_of(sources: Sequence[Source], points: Points) -> Vectors:
    """Magnetic flux density of all sources together; the Earth's field is not in it.

    A dipole gives ``mu0 / (4 pi) (3 (m . r) r / r^5 - m / r^3)``, and so do the bodies from afar, with
    ``m = J V / mu0``.

    Examples
    --------
    >>> bar = Dipole(center=np.zeros(3), moment=np.array([0.0, 0.0, 1.0]))
    >>> field_of([bar], np.array([[0.0, 0.0, 1.0]])).round(9).tolist()
    [[0.0, 0.0, 2e-07]]
    """
    field = np.zeros((len(points), 3))
    if not sources or not len(points):
        return field
    magpylib = import_extra("magpylib", "simulating magnetic sources", "simulation")
    bodies = [source.in_magpylib(magpylib) for source in sources]
    step = max(_PAIRS_AT_ONCE // len(bodies), 1)
    for start in range(0, len(points), step):
        part = points[start : start + step]
        with np.errstate(all="ignore"):
            field[start : start + step] = np.reshape(magpylib.getB(bodies, part, sumup=True), (-1, 3))
    wrong = np.flatnonzero(~np.isfinite(field).all(axis=1))
    if len(wrong):
        msg = (
            f"points: expected none at a dipole, whose field is infinite there, found point {wrong[0]}; move it away"
        )
        raise ValueError(msg)
    return field


def _outside(beyond: Matrix) -> Scalars:
    """Distance of points that lie so far beyond a body's faces, along each axis."""
    return np.asarray(np.linalg.norm(np.maximum(beyond, 0), axis=1))
