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
    _sums: list[np.ndarray | float] = field(default_factory=list)

    def add(self, t: float, T: Matrix, z: Vector3) -> Bin | None:
        """Take a sample, the body's pose as a (4, 4) matrix; gives the bin before it where that is complete."""
        R, p = T[:3, :3], T[:3, 3]
        done = None
        if self.n and ((p - self._first) ** 2).sum() > self.side**2:
            done = self._close()
            self.n = 0
        if self.n == 0:
            self._first, self._sums = p, [0.0, 0.0, 0.0, 0.0]
        self.n += 1
        self._sums = [a + b for a, b in zip(self._sums, (t, R, p, R @ z), strict=True)]
        return done

    def _close(self) -> Bin:
        t, R_mean, p, b = (np.asarray(s) / self.n for s in self._sums)
        U, _, Vt = np.linalg.svd(R_mean)
        R = U @ np.diag([1.0, 1.0, np.linalg.det(U @ Vt)]) @ Vt
        return Bin(float(t), R, p, R.T @ b, R.T @ R_mean)
