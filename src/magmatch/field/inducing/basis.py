# SPDX-License-Identifier: BSD-3-Clause
"""The interface between a dense model and its basis: Gaussians on a grid, or charges around a region."""

from typing import Protocol

import numpy as np

from magmatch.field.linear_model import Axes
from magmatch.field.values import FieldValues
from magmatch.typing import Mask, Matrix, Points, Vector3


class Basis(Protocol):
    """Vector fields that weights (T) stand for, with unit prior variance of a component."""

    @property
    def n_weights(self) -> int:
        """How many."""
        ...

    def is_whole(self, points: Points) -> Mask:
        """Where the basis alone is the prior; elsewhere the prior has a part that the basis cannot represent."""
        ...

    def design(self, points: Points, order: int = 0) -> Matrix:
        """Field and derivatives per unit of each weight: (rows n, m), rows component-major."""
        ...

    def evaluate(self, points: Points, weights: np.ndarray, order: int, constant: Vector3) -> FieldValues:
        """Field and derivatives at points."""
        ...

    def evaluate_on_grid(self, axes: Axes, weights: np.ndarray, order: int, constant: Vector3) -> FieldValues:
        """Field and derivatives on the grid spanned by three axes, in C order."""
        ...
