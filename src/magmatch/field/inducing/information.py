# SPDX-License-Identifier: BSD-3-Clause
"""Information of samples on the weights of a dense model: sums over samples, which add and subtract."""

from dataclasses import dataclass

import numpy as np

from magmatch.typing import Matrix, Scalars


@dataclass(frozen=True, eq=False, slots=True)
class DenseInformation:
    """Information in samples about whitened weights (prior N(0, I)), in units of the noise.

    ``gram = sum W A^T A / s^2`` (lower triangle), ``eta = sum W A^T b / s^2``, ``square = sum W |b|^2 / s^2``.
    """

    gram: Matrix
    eta: Scalars
    square: float
    n_values: float

    def __add__(self, other: "DenseInformation") -> "DenseInformation":
        """Information of both data sets."""
        self._check_same_basis(other)
        return DenseInformation(
            self.gram + other.gram, self.eta + other.eta, self.square + other.square, self.n_values + other.n_values
        )

    def __sub__(self, other: "DenseInformation") -> "DenseInformation":
        """Take off information that was counted twice."""
        self._check_same_basis(other)
        return DenseInformation(
            self.gram - other.gram, self.eta - other.eta, self.square - other.square, self.n_values - other.n_values
        )

    @classmethod
    def none(cls, n_weights: int) -> "DenseInformation":
        """No sample at all."""
        return cls(np.zeros((n_weights, n_weights), order="F"), np.zeros(n_weights), 0.0, 0.0)

    def _check_same_basis(self, other: "DenseInformation") -> None:
        if self.eta.shape != other.eta.shape:
            msg = (
                f"expected information about the same basis, got {len(self.eta)} and {len(other.eta)} weights; "
                "observe both data sets with one model"
            )
            raise ValueError(msg)
