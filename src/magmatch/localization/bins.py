# SPDX-License-Identifier: BSD-3-Clause
"""Samples averaged in short bins along the path as they arrive: dependent samples count once."""

from dataclasses import dataclass, field

import numpy as np

from magmatch.compiled import compiled
from magmatch.features.wahba import to_rotation
from magmatch.typing import ROTATION, VECTOR

# A bin: means of its time (s), of the body's pose in the odometry's frame, and of the field (T) in that pose's axes,
# with its derivative by the sensor's bias. And the odometry that leads to it: turn, shift (m, in the axes of the body
# before) and time from the bin before, and the path so far (m); until it is placed behind others, zeros.
STEP = np.dtype([
    ("dR", ROTATION), ("u", VECTOR), ("dt", "f8"), ("z", VECTOR), ("M", ROTATION), ("R", ROTATION), ("p", VECTOR),
    ("t", "f8"), ("walked", "f8"),
])  # fmt: skip
# Sums over a bin's samples: number, times, poses, fields in the odometry's axes; and where its first lies.
SUMS = np.dtype([("n", "i8"), ("t", "f8"), ("T", "f8", (3, 4)), ("b", VECTOR), ("first", VECTOR)])


@dataclass(eq=False, slots=True)
class Binning:
    """A new bin begins at a sample that lies farther than ``side`` (m) from the bin's first."""

    side: float
    # The bin under way, and the last that is complete.
    _sums: np.ndarray = field(default_factory=lambda: np.zeros(2, SUMS))

    def add(self, sample: np.ndarray) -> np.ndarray | None:
        """Add a sample, (1,) of `samples.SAMPLE`; gives the bin, (1,) of STEP, that it completes."""
        if not _add(self._sums, sample, self.side):
            return None
        done = np.zeros(1, STEP)
        _average(self._sums, done, *np.empty((2, 4, 4)))
        return done


@compiled
def _add(sums, sample, side):  # type: ignore[no-untyped-def]
    """Add a sample; whether it began another bin."""
    now, one = sums[0], sample[0]
    T, z, first = one.T, one.z, now.first
    x, y, w = T[0, 3] - first[0], T[1, 3] - first[1], T[2, 3] - first[2]
    is_done = now.n > 0 and x * x + y * y + w * w > side * side
    if is_done:
        sums[1] = sums[0]
    if is_done or now.n == 0:
        now.n, now.t = 0, 0.0
        for a in range(3):
            first[a], now.b[a] = T[a, 3], 0.0
            for e in range(4):
                now.T[a, e] = 0.0
    now.n += 1
    now.t += one.t
    for a in range(3):
        now.b[a] += T[a, 0] * z[0] + T[a, 1] * z[1] + T[a, 2] * z[2]
        for e in range(4):
            now.T[a, e] += T[a, e]
    return is_done


@compiled
def _average(sums, found, K, V):  # type: ignore[no-untyped-def]
    """Fill in the means of the complete bin."""
    done, one = sums[1], found[0]
    R = one.R
    one.t = done.t / done.n
    for a in range(3):
        one.p[a] = done.T[a, 3] / done.n
        for e in range(3):
            R[a, e] = done.T[a, e] / done.n
    to_rotation(R, K, V)
    for a in range(3):
        for e in range(3):
            one.z[a] += R[e, a] * done.b[e] / done.n
            for k in range(3):
                one.M[a, e] += R[k, a] * done.T[k, e] / done.n
