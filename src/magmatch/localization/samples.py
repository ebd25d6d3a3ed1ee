# SPDX-License-Identifier: BSD-3-Clause
"""Samples from a caller, each checked before any state is changed."""

import math
from dataclasses import dataclass, field
from typing import NoReturn

import numpy as np

from magmatch.arguments import found, numbers_of
from magmatch.compiled import compiled
from magmatch.data.checks import MAX_FIELD, ODD_SPEED, too_large
from magmatch.number_text import told
from magmatch.typing import POSE, VECTOR, Matrix, Vector3

# A body that moves farther at once, and faster than bodies do, has not moved: its odometry began anew. m
MOST_STEP = 5.0
# The last sample: time (-inf before the first), the body in an odometry's frame without jumps, field in its axes;
# where the odometry had it and how its frame lies in that without jumps; and the next, until it is checked.
SAMPLE = np.dtype([
    ("t", "f8"), ("T", POSE), ("z", VECTOR), ("p_given", VECTOR), ("T_odom_given", POSE), ("next_t", "f8"),
    ("next_T", POSE), ("next_z", VECTOR),
])  # fmt: skip
FINE, BAD_TIME, BAD_POSE, BAD_FIELD, LARGE_FIELD, BACKWARD, JUMP = range(7)


class OdometryJump(ValueError):
    """The odometry jumped: it moved faster than any body; it is followed from where it jumped to."""


def _none() -> np.ndarray:
    last = np.zeros(1, SAMPLE)
    last["t"], last["T"], last["T_odom_given"] = -np.inf, np.eye(4), np.eye(4)
    return last


@dataclass(eq=False, slots=True)
class LastSample:
    """The last sample, (1,) of SAMPLE."""

    last: np.ndarray = field(default_factory=_none)

    @property
    def T_odom_body(self) -> Matrix:
        """The pose of the body at that time, in an odometry's frame without jumps."""
        return np.asarray(self.last["T"][0])

    def take(self, t: float, T: Matrix, b: Vector3) -> np.ndarray:
        """Check a sample, T its body's pose, a rigid (4, 4) matrix, and remember it; gives it, (1,) of SAMPLE.

        Raises `ValueError` (an `OdometryJump` is one) or `TypeError` that say what was expected and found.
        """
        time = t if isinstance(t, float) else numbers_of(t, "t", "(), in s")
        z = numbers_of(b, "field", "(3,), in T")
        # To ask NumPy about a float would take as long as all else here.
        is_one = isinstance(time, float) or not np.ndim(time)
        fault = BAD_TIME if not is_one else BAD_FIELD if z.shape != (3,) else FINE
        if not fault:
            self.last["next_t"], self.last["next_T"], self.last["next_z"] = time, T, z
            fault = _take(self.last)
        if fault:
            self._refuse(fault, t, b)
        return self.last

    def _refuse(self, fault: int, t: float, b: Vector3) -> NoReturn:
        """Say what is wrong; an odometry that began anew is followed from there."""
        one = self.last[0]
        if fault == BAD_TIME:
            msg = f"t: expected one finite number, in s, got {found(t)}"
        elif fault == BAD_POSE:
            msg = "T_odom_body: expected finite numbers, got NaN or infinity; leave such samples out"
        elif fault == BAD_FIELD:
            is_row, got = np.shape(b) == (3,), np.asarray(b)
            advice = "leave such samples out" if is_row else "give x, y, z of one sample"
            msg = (
                f"field: expected three finite numbers, in T, got {got.tolist() if is_row else found(got)}; {advice}"
            )
        elif fault == LARGE_FIELD:
            msg = too_large(math.sqrt(one["next_z"] @ one["next_z"]))
        elif fault == BACKWARD:
            msg = f"t: expected a time after {told(one['t'])} s, got {told(one['next_t'])}"
        else:
            T, p = one["next_T"], one["p_given"]
            step = f"{math.dist(T[:3, 3], p):.3g} m in {one['next_t'] - one['t']:.3g} s"
            # Whatever the odometry says from here on is relative to where it believes to be now.
            one["T_odom_given"], p[:] = one["T"] @ np.linalg.inv(T), T[:3, 3]
            msg = f"T_odom_body: expected a step, got a jump of {step}; it counts as none"
            raise OdometryJump(msg)
        raise ValueError(msg)


@compiled
def _take(last):  # type: ignore[no-untyped-def]
    """Remember the next sample, unless something is wrong with it: that is the answer."""
    one = last[0]
    T = one.next_T
    fault = _fault(one)
    if fault == FINE:
        one.t = one.next_t
        for a in range(3):
            one.z[a], one.p_given[a] = one.next_z[a], T[a, 3]
            for e in range(4):
                total = 0.0
                for k in range(4):
                    total += one.T_odom_given[a, k] * T[k, e]
                one.T[a, e] = total
    return fault


@compiled
def _fault(one):  # type: ignore[no-untyped-def]
    T, z, p = one.next_T, one.next_z, one.p_given
    if not np.isfinite(one.next_t):
        return BAD_TIME
    for a in range(4):
        for e in range(4):
            if not np.isfinite(T[a, e]):
                return BAD_POSE
    if not (np.isfinite(z[0]) and np.isfinite(z[1]) and np.isfinite(z[2])):
        return BAD_FIELD
    if np.sqrt(z[0] ** 2 + z[1] ** 2 + z[2] ** 2) > MAX_FIELD:
        return LARGE_FIELD
    if one.next_t <= one.t:
        return BACKWARD
    moved = np.sqrt((T[0, 3] - p[0]) ** 2 + (T[1, 3] - p[1]) ** 2 + (T[2, 3] - p[2]) ** 2)
    # Since -inf there was time for any step.
    return JUMP if moved > MOST_STEP + ODD_SPEED * (one.next_t - one.t) else FINE
