# SPDX-License-Identifier: BSD-3-Clause
"""Solutions from a single-precision factor, by iterative refinement to double precision."""

import numpy as np

from magmatch.field.cholesky.cells import CellGrid
from magmatch.field.cholesky.multifrontal import CholeskyFactor
from magmatch.field.cholesky.stencil_matrix import StencilMatrix
from magmatch.typing import Scalars

# What the next correction may still change, relative to the largest entry (a solution in double is right to 1e-12);
# how many may be needed, and by how much each has to be smaller than the last.
TOLERANCE, MOST_CORRECTIONS, SLOWEST = 1e-11, 8, 0.2


def refined_solve(A: StencilMatrix, factor: CholeskyFactor, rhs: Scalars, cells: CellGrid) -> Scalars | None:
    """Solve ``A x = rhs`` by iterative refinement (Wilkinson 1963)."""
    x = factor.solve(rhs)
    size = last = float(np.abs(x).max())
    for _ in range(MOST_CORRECTIONS):
        correction = factor.solve(rhs - A.times(x, cells))
        x = x + correction
        change = float(np.abs(correction).max())
        if not change < SLOWEST * last:
            return None
        # Corrections shrink by about the same factor each time, which tells the next one without computing it.
        if change * change / last <= TOLERANCE * size:
            return np.asarray(x)
        last = change
    return None
