# SPDX-License-Identifier: BSD-3-Clause
"""Samples as they come, averaged in short bins along the path: what is not independent counts once."""

from dataclasses import dataclass, field

import numpy as np

from magmatch.typing import Matrix, Vector3


@dataclass(eq=False, slots=True)
class Bin:
    """Samples of a bin.

    Attributes
    ----------
    t : float, s
        Mean time.
    R, p : (3, 3) and (3,) arrays
        Mean pose of the body in the odometry's frame.
    z : (3,) array, T
        Mean field, in the mean body's axes.
    M : (3, 3) array
        How a bias of the sensor enters it.
    """

    t: float
    R: Matrix
    p: Vector3
    z: Vector3
    M: Matrix


@dataclass(eq=False, slots=True)
class Binning:
    """A new bin begins at a sample that lies farther than ``side`` (m) from the bin's first."""

    side: float
    n: int = 0
    _first: Vector3 = field(default_factory=lambda: np.zeros(3))
    _t: float = 0.0
    _T: Matrix = field(default_factory=lambda: np.zeros((4, 4)))
    _b: Vector3 = field(default_factory=lambda: np.zeros(3))

    def add(self, t: float, T: Matrix, z: Vector3) -> Bin | None:
        """Take a sample, the body's pose as a (4, 4) matrix; gives the bin before it where that is complete."""
        p, done = T[:3, 3], None
        if self.n and (moved := p - self._first) @ moved > self.side**2:
            done = self._close()
            self.n = 0
        if self.n == 0:
            self._first, self._t = p, 0.0
            self._T[:], self._b[:] = 0.0, 0.0
        self.n += 1
        self._t += t
        self._T += T
        self._b += T[:3, :3] @ z
        return done

    def _close(self) -> Bin:
        R_mean, p = self._T[:3, :3] / self.n, self._T[:3, 3] / self.n
        U, _, Vt = np.linalg.svd(R_mean)
        if np.linalg.det(U @ Vt) < 0:
            U[:, 2] *= -1
        R = U @ Vt
        return Bin(self._t / self.n, R, p, R.T @ self._b / self.n, R.T @ R_mean)
