# SPDX-License-Identifier: BSD-3-Clause
"""Values of a field model at points: the vectors and their derivatives."""

from dataclasses import dataclass
from typing import Protocol

import numpy as np
from scipy.linalg import block_diag
from scipy.spatial.transform import RigidTransform

from magmatch.brief import brief
from magmatch.geometry import rotate_tensors, rotate_third_order, rotate_vectors, rotation_matrix
from magmatch.grid import RegularGrid
from magmatch.typing import Mask, Points, Scalars, Tensors, ThirdOrder, Vectors


@dataclass(frozen=True, eq=False, slots=True)
class FieldValues:
    """Field and derivatives at n points, all in one frame."""

    field: Vectors  # (n, 3), T
    gradient: Tensors | None = None  # (n, 3, 3), T/m: ``[i, a, b] = dB_a / dx_b``; present from order 1
    # (n, 3, 3, 3), T/m^2: ``[i, a, b, c] = d2 B_a / dx_b dx_c``; present from order 2
    second: ThirdOrder | None = None

    __repr__ = brief

    def rotated(self, T_new_old: RigidTransform) -> "FieldValues":
        """Return the same values with their components in another frame."""
        return FieldValues(
            rotate_vectors(self.field, T_new_old),
            None if self.gradient is None else rotate_tensors(self.gradient, T_new_old),
            None if self.second is None else rotate_third_order(self.second, T_new_old),
        )

    @staticmethod
    def turning_matrix(T_new_old: RigidTransform, order: int) -> np.ndarray:
        """Matrix that turns a point's field (order 0: (3, 3)) or field and gradient, row-major (1: (12, 12))."""
        R = rotation_matrix(T_new_old)
        return R if order == 0 else block_diag(R, np.kron(R, R))


@dataclass(frozen=True, eq=False, slots=True)
class GriddedField:
    """A map evaluated on a regular grid; arrays are in the grid's C order, components in the map frame."""

    grid: RegularGrid
    values: FieldValues  # field and derivatives at ``grid.points()``
    # (n,), T^2: mean posterior variance of the three components, returning to the prior away from data; NaN where it
    # was not asked for
    variance: Scalars
    is_known: Mask  # (n,): where the map has data nearby


class FieldFunction(Protocol):
    """A field that can be evaluated at points."""

    def evaluate(self, points: Points, order: int = 0) -> FieldValues:
        """Field and, for order 1, its gradient."""


def gradient_of(values: FieldValues) -> Tensors:
    """Gradient of values that were asked for with order 1."""
    if values.gradient is None:
        msg = "the posterior gave no gradient although order 1 was asked for"
        raise ValueError(msg)
    return values.gradient


def gradient_norm(gradient: Tensors) -> Scalars:
    """Frobenius norm of gradient tensors, T/m: (n,)."""
    return np.asarray(np.sqrt(np.einsum("nij,nij->n", gradient, gradient)))
