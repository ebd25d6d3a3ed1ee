# SPDX-License-Identifier: BSD-3-Clause
"""The factors of a posterior precision: double for covariances, single if an error of a thousandth is acceptable."""

from collections.abc import Callable
from functools import partial

import numpy as np

from magmatch.field.cholesky.multifrontal import CholeskyFactor

# Gives the factor in a precision, or a better one where that does not do.
Make = Callable[[type[np.floating]], CholeskyFactor]


class Factors:
    """Factors of one matrix, each made when it is first asked for."""

    def __init__(self, make: Make, made: CholeskyFactor | None = None) -> None:
        self._make = make
        self._made: dict[type[np.floating], CholeskyFactor] = {}
        if made is not None:
            self._keep(np.float32, made)

    @classmethod
    def of(cls, factor: CholeskyFactor) -> "Factors":
        """One factor for everything."""
        return cls(partial(_same, factor), factor)

    @classmethod
    def gone(cls) -> "Factors":
        """None: who asks for one is told."""
        return cls(_refuse)

    @property
    def full(self) -> CholeskyFactor:
        """In double precision."""
        return self._find(np.float64)

    @property
    def light(self) -> CholeskyFactor:
        """In single precision, or in double where that does not do: spreads are right to a thousandth."""
        return self._find(np.float32)

    @property
    def n_bytes(self) -> int:
        """Memory of those that were made."""
        # A list, since another thread may make one meanwhile.
        return sum(factor.n_bytes for factor in {id(f): f for f in list(self._made.values())}.values())

    def _find(self, precision: type[np.floating]) -> CholeskyFactor:
        if precision not in self._made:
            self._keep(precision, self._make(precision))
        return self._made[precision]

    def _keep(self, precision: type[np.floating], factor: CholeskyFactor) -> None:
        self._made[precision] = factor
        if factor.precision == np.float64:
            self._made[np.float64] = factor


def _same(factor: CholeskyFactor, _: type[np.floating]) -> CholeskyFactor:
    return factor


def _refuse(_: type[np.floating]) -> CholeskyFactor:
    msg = "the factors of this posterior are not kept: only its mean can be evaluated"
    raise RuntimeError(msg)
