# SPDX-License-Identifier: BSD-3-Clause
"""Compiled fields of point charges: ``B = r / |r|^3`` of a unit charge, with derivatives.

Magnetic charges do not exist, but a layer of them outside a region represents any field without sources inside it.
The field of each is exactly curl-free and divergence-free away from the charge. Only distinct derivatives are formed,
in the order of `spline_basis.derivative_table`.
"""

import numpy as np

from magmatch.compiled import compiled
from magmatch.field.spline.spline_basis import derivative_table
from magmatch.typing import Matrix, Points, Scalars


@compiled
def _rows(x: float, y: float, z: float, order: int, out: np.ndarray) -> None:
    """Field and distinct derivatives of a unit charge at offset (x, y, z) from it."""
    q = 1.0 / (x * x + y * y + z * z)
    a = q * np.sqrt(q)
    out[0], out[1], out[2] = a * x, a * y, a * z
    if order == 0:
        return
    b = -3.0 * a * q
    out[3], out[4], out[5] = a + b * x * x, b * x * y, b * x * z
    out[6], out[7], out[8] = a + b * y * y, b * y * z, a + b * z * z
    if order == 1:
        return
    c = -5.0 * b * q
    out[9] = x * (3 * b + c * x * x)
    out[10], out[11] = y * (b + c * x * x), z * (b + c * x * x)
    out[12], out[13], out[14] = x * (b + c * y * y), c * x * y * z, x * (b + c * z * z)
    out[15] = y * (3 * b + c * y * y)
    out[16], out[17] = z * (b + c * y * y), y * (b + c * z * z)
    out[18] = z * (3 * b + c * z * z)


@compiled
def _fill(points: np.ndarray, sources: np.ndarray, order: int, out: np.ndarray) -> None:
    row = np.zeros(out.shape[0])
    for i in range(len(points)):
        for j in range(len(sources)):
            _rows(
                points[i, 0] - sources[j, 0], points[i, 1] - sources[j, 1], points[i, 2] - sources[j, 2], order, row
            )  # fmt: skip
            for k in range(len(row)):
                out[k, i, j] = row[k]


@compiled
def _sum(points: np.ndarray, sources: np.ndarray, charges: np.ndarray, order: int, out: np.ndarray) -> None:
    row = np.zeros(out.shape[1])
    for i in range(len(points)):
        for j in range(len(sources)):
            _rows(
                points[i, 0] - sources[j, 0], points[i, 1] - sources[j, 1], points[i, 2] - sources[j, 2], order, row
            )  # fmt: skip
            for k in range(len(row)):
                out[i, k] += charges[j] * row[k]


def charge_design(points: Points, sources: Points, order: int) -> np.ndarray:
    """Field and distinct derivatives at points per unit charge."""
    out = np.empty((len(derivative_table(order)), len(points), len(sources)))
    _fill(points, sources, order, out)
    return out


def charge_field(points: Points, sources: Points, charges: Scalars, order: int) -> Matrix:
    """Field and distinct derivatives at points of given charges (T m^2): (n, 3, 9 or 19), T, T/m, T/m^2."""
    out = np.zeros((len(points), len(derivative_table(order))))
    _sum(points, sources, charges, order, out)
    return out
