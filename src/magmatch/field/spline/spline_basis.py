# SPDX-License-Identifier: BSD-3-Clause
"""Tensor products of cubic B-splines on unit cells: values, derivatives and rows of the linear model.

A cell is touched by 4 splines along each axis, 64 in all, numbered ``16 a + 4 b + c``. The potential is
``phi = h sum_k w_k b(u_x) b(u_y) b(u_z)`` with ``u = (x - origin) / h``, so that the field ``B = -grad phi`` has the
weights' own unit (T) and every further derivative brings a factor ``1 / h``.
"""

import numpy as np

from magmatch.compiled import compiled
from magmatch.field.values import FieldValues


def _derivatives(order: int) -> tuple[np.ndarray, np.ndarray]:
    """Distinct derivatives of an order: how often along x, y, z (n, 3); and which one is along axes (a, b, ...)."""
    axes = np.sort(np.indices((3,) * order).reshape(order, -1).T, axis=1)
    distinct, index = np.unique(axes, axis=0, return_inverse=True)
    return np.array([np.bincount(along, minlength=3) for along in distinct]), index.reshape((3,) * order)


# Of phi, its 3 first, 6 second and 10 third derivatives.
FIRST, _ = _derivatives(1)
SECOND, GRADIENT_INDEX = _derivatives(2)
THIRD, SECOND_INDEX = _derivatives(3)


def derivative_table(order: int) -> np.ndarray:
    """Derivatives of the potential that the field (order 0), its gradient (1) and second derivatives (2) need."""
    if order not in (0, 1, 2):
        msg = f"expected derivatives of order 0, 1 or 2, got {order}"
        raise ValueError(msg)
    return np.concatenate([FIRST, SECOND, THIRD][: order + 1])


def values_of(distinct: np.ndarray, constant: np.ndarray, order: int) -> FieldValues:
    """Field values beside a constant field, from the list of distinct derivatives."""
    return FieldValues(
        distinct[:, :3] + constant,
        distinct[:, 3:9][:, GRADIENT_INDEX] if order >= 1 else None,
        distinct[:, 9:][:, SECOND_INDEX] if order >= 2 else None,
    )


@compiled
def spline_values(t: float, values: np.ndarray) -> None:
    """Fill ``values[d, i]`` with the d-th derivative of the i-th cubic spline at ``0 <= t < 1``."""
    t2 = t * t
    t3 = t2 * t
    s = 1.0 - t
    values[0, 0] = s * s * s / 6.0
    values[0, 1] = (4.0 - 6.0 * t2 + 3.0 * t3) / 6.0
    values[0, 2] = (1.0 + 3.0 * t + 3.0 * t2 - 3.0 * t3) / 6.0
    values[0, 3] = t3 / 6.0
    values[1, 0] = -0.5 * s * s
    values[1, 1] = 1.5 * t2 - 2.0 * t
    values[1, 2] = 0.5 + t - 1.5 * t2
    values[1, 3] = 0.5 * t2
    values[2, 0] = s
    values[2, 1] = 3.0 * t - 2.0
    values[2, 2] = 1.0 - 3.0 * t
    values[2, 3] = t
    values[3, 0] = -1.0
    values[3, 1] = 3.0
    values[3, 2] = -3.0
    values[3, 3] = 1.0


@compiled
def derivative_rows(
    vx: np.ndarray, vy: np.ndarray, vz: np.ndarray, derivatives: np.ndarray, spacing: float, rows: np.ndarray
) -> None:
    """Fill ``rows[r, :64]`` so that ``rows[r] @ w`` is minus the r-th derivative of phi (of B, that is)."""
    for r in range(derivatives.shape[0]):
        dx, dy, dz = derivatives[r, 0], derivatives[r, 1], derivatives[r, 2]
        scale = -1.0
        for _ in range(dx + dy + dz - 1):
            scale /= spacing
        k = 0
        for a in range(4):
            for b in range(4):
                ab = scale * vx[dx, a] * vy[dy, b]
                for c in range(4):
                    rows[r, k] = ab * vz[dz, c]
                    k += 1
