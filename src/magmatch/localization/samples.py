# SPDX-License-Identifier: BSD-3-Clause
"""Samples as a caller hands them in: checked one by one before anything is changed."""

import math
from dataclasses import dataclass, field

import numpy as np

from magmatch.arguments import numbers_of
from magmatch.data.checks import MAX_FIELD
from magmatch.typing import Matrix, Vector3

# A body that moves faster has not moved: its odometry began anew, m/s (and m, of clocks that jitter).
MOST_SPEED, MOST_STEP = 50.0, 5.0


class OdometryJump(ValueError):
    """The odometry says that the body moved faster than any; it goes on from where it jumped to."""


@dataclass(eq=False, slots=True)
class Samples:
    """The last sample, in an odometry's frame without jumps."""

    t: float | None = None
    T_odom_body: Matrix = field(default_factory=lambda: np.eye(4))
    _given: Matrix = field(default_factory=lambda: np.eye(4))
    _T_odom_given: Matrix = field(default_factory=lambda: np.eye(4))

    def take(self, t: float, T: Matrix, b: Vector3) -> tuple[float, Matrix, Vector3]:
        """Check a sample, T its body's pose, a rigid (4, 4) matrix, and remember it.

        Raises
        ------
        ValueError, TypeError
            What was expected and what was found; an `OdometryJump` is one.
        """
        time = t if isinstance(t, float) else numbers_of(t, "t", "(), in s")
        if np.ndim(time) or not math.isfinite(time):
            msg = f"t: expected a finite number of seconds, got {t!r:.40}"
            raise ValueError(msg)
        if not np.isfinite(T).all():
            msg = "T_odom_body: expected finite numbers, got NaN or infinity; leave such samples out"
            raise ValueError(msg)
        z = numbers_of(b, "field", "(3,), in T")
        if z.shape != (3,) or not np.isfinite(z).all():
            msg = f"field: expected three finite numbers, in T, got {np.asarray(b)!r:.60}; leave such samples out"
            raise ValueError(msg)
        if (size := math.sqrt(z @ z)) > MAX_FIELD:
            msg = f"field: expected at most {MAX_FIELD:g} T, got {size:.3g}; if it is in uT, multiply by 1e-6"
            raise ValueError(msg)
        now = float(time)
        if self.t is None:
            self.t, self.T_odom_body, self._given = now, T, T
            return now, T, z
        if now <= self.t:
            msg = f"t: expected a time after {self.t:.9g} s, got {now:.9g}"
            raise ValueError(msg)
        moved = math.dist(T[:3, 3].tolist(), self._given[:3, 3].tolist())
        if moved > MOST_STEP + MOST_SPEED * (now - self.t):
            # Whatever the odometry says from here on is relative to where it believes to be now.
            self._T_odom_given, self._given = self.T_odom_body @ np.linalg.inv(T), T
            step = f"{moved:.3g} m in {now - self.t:.3g} s"
            msg = f"T_odom_body: expected a step, got a jump of {step}; it counts as none"
            raise OdometryJump(msg)
        self.t, self._given = now, T
        self.T_odom_body = self._T_odom_given @ T
        return now, self.T_odom_body, z
