# SPDX-License-Identifier: BSD-3-Clause
"""Which spacing of the splines a survey can afford."""

import logging

import numpy as np

from magmatch.field.cells import MAX_ACTIVE_CELLS, MAX_BOX_CELLS, count_active_cells, lay_cells
from magmatch.field.nested_dissection import order_elimination
from magmatch.typing import Points

log = logging.getLogger(__name__)

# Operations of one factorisation of the whole survey: at the finest spacing that the search may wish for (a constant
# and a share per sample), and at most; a spacing that would cost more than the last is widened.
FINE_OPERATIONS, MOST_OPERATIONS = (4e9, 1e6), 1.5e11
COARSER = 1.25


def affordable_spacing(points: Points, spacing: float, reach: float) -> float:
    """A spacing, widened until the whole survey can be fitted in bounded time and memory.

    Parameters
    ----------
    points : (n, 3) array, m
    spacing : float, m
        What would be right.
    reach : float, cells
        How far the basis reaches beyond occupied cells.

    Returns
    -------
    float, m
    """
    wished = spacing
    while (operations := _operations(points, spacing, reach)) > MOST_OPERATIONS:
        n_box = np.prod(np.ptp(points, axis=0) / spacing + 1)
        spacing *= COARSER if np.isfinite(operations) else max(COARSER, (n_box / MAX_BOX_CELLS) ** (1 / 3))
    if spacing > wished:
        log.warning("the survey is large: spacing widened from %.3g m to %.3g m", wished, spacing)
    return spacing


def is_affordable(points: Points, spacing: float, reach: float) -> bool:
    """Whether a survey can be fitted at a spacing that is finer than it has to be."""
    return _operations(points, spacing, reach) <= FINE_OPERATIONS[0] + FINE_OPERATIONS[1] * len(points)


def _operations(points: Points, spacing: float, reach: float) -> float:
    """Cost of one factorisation over the surroundings of points; infinite where memory does not allow it."""
    n_active, n_box = count_active_cells(points, spacing, reach)
    if n_box > MAX_BOX_CELLS or n_active > MAX_ACTIVE_CELLS // 2:
        return np.inf
    return order_elimination(lay_cells(points, spacing, reach)).n_operations
