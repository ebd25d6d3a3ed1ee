# SPDX-License-Identifier: BSD-3-Clause
"""Whether the rows of a survey are a path: lines through them, and lengths along them, mean nothing otherwise."""

import numpy as np
from scipy.spatial import cKDTree

from magmatch.data.survey import Survey

# Of a path, a row's next one is about as near as any; of a shuffled volume, it is many times farther than the
# nearest.
LARGEST_STEP = 5.0
# Rows that are looked at.
N_LOOKED_AT = 2000


def has_order(survey: Survey) -> bool:
    """Whether the rows are a path: with times they are; else steps are compared with the nearest neighbours."""
    if survey.times is not None:
        return True
    if len(survey) < 2:
        return False
    p = survey.positions
    steps = np.linalg.norm(np.diff(p, axis=0), axis=1)
    rows = np.linspace(0, len(p) - 1, min(len(p), N_LOOKED_AT)).astype(int)
    nearest = np.asarray(cKDTree(p).query(p[rows], k=2)[0])[:, 1]
    return bool(np.median(steps) <= LARGEST_STEP * np.median(nearest))
