# SPDX-License-Identifier: BSD-3-Clause
"""The smallest spacing of the splines at which fitting a survey is affordable."""

import logging

import numpy as np

from magmatch.field.cholesky.cells import MAX_BOX_CELLS
from magmatch.field.hyperparameters import Hyperparameters
from magmatch.field.tiles.region_model import fit_operations
from magmatch.typing import Points

log = logging.getLogger(__name__)

# Operations of one fit of the whole survey, a constant and a share per sample: at the finest spacing that the search
# may wish for, and at most; a spacing that would cost more than the last is widened.
FINE_OPERATIONS, MOST_OPERATIONS = (4e9, 2e5), (1e11, 1.5e6)
COARSER = 1.25


def affordable_spacing(points: Points, hyperparameters: Hyperparameters) -> float:
    """A spacing, widened until the whole survey can be fitted in bounded time and memory."""
    h, spacing = hyperparameters, hyperparameters.spacing
    while _operations(points, h, spacing) > _budget(MOST_OPERATIONS, len(points)):
        spacing *= COARSER
    if spacing > h.spacing:
        log.warning("the survey is large: spacing widened from %.3g m to %.3g m", h.spacing, spacing)
    return spacing


def is_affordable(points: Points, hyperparameters: Hyperparameters, times: float = 1.0) -> bool:
    """Whether a survey can be fitted at a spacing finer than it has to be; ``times``: of what that may cost."""
    budget = times * _budget(FINE_OPERATIONS, len(points))
    return _operations(points, hyperparameters, hyperparameters.spacing) <= budget


def _operations(points: Points, h: Hyperparameters, spacing: float) -> float:
    """Cost of one fit over the surroundings of points; infinite where the search could not lay its cells at once."""
    if np.prod(np.ptp(points, axis=0) / spacing + 2 * h.reach + 1) > MAX_BOX_CELLS:
        return np.inf
    ratio = h.lengthscale / h.spacing
    return fit_operations(points, Hyperparameters(ratio * spacing, 1.0, 1.0, spacing, reach=h.reach))


def _budget(terms: tuple[float, float], n: int) -> float:
    return terms[0] + terms[1] * n
