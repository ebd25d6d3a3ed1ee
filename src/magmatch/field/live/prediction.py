# SPDX-License-Identifier: BSD-3-Clause
"""Prediction of a live estimate at points."""

from dataclasses import dataclass

import numpy as np

from magmatch.field.values import FieldValues
from magmatch.typing import Mask, Vectors


@dataclass(frozen=True, eq=False, slots=True)
class Prediction:
    """What is known about the field at n points, map frame."""

    values: FieldValues  # posterior mean of field and derivatives
    covariance: np.ndarray  # (n, 3, 3), T^2: of the noise-free field; where blocks blend, an upper bound
    is_known: Mask  # (n,): where there are samples near

    @property
    def field(self) -> Vectors:
        """Mean of the field, T."""
        return self.values.field

    @property
    def variance(self) -> Vectors:
        """Variance of each component, T^2: (n, 3)."""
        return np.asarray(np.diagonal(self.covariance, axis1=1, axis2=2))
