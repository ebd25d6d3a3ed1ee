# SPDX-License-Identifier: BSD-3-Clause
"""Whether the rows of a survey are a path: lines through them, and lengths along them, mean nothing otherwise."""

import numpy as np

from magmatch.data.survey import Survey

# Of a path, a row's next one is nearer than two rows at random are (rms); of rows in no order it is about as far.
LARGEST_STEP = 0.6


def has_order(survey: Survey) -> bool:
    """Whether the rows are a path: with times they are; else steps are compared with the size of the whole."""
    if survey.times is not None:
        return True
    if len(survey) < 2:
        return False
    p = survey.positions
    step = np.median(np.linalg.norm(np.diff(p, axis=0), axis=1))
    return bool(step <= LARGEST_STEP * np.sqrt(2 * p.var(axis=0).sum()))
