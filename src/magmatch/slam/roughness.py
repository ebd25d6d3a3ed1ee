# SPDX-License-Identifier: BSD-3-Clause
"""How rough the field is along a path, which is all that a map of one pass has to go by beside it."""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from magmatch.data.survey import Survey
from magmatch.field.hyperparameters import Hyperparameters
from magmatch.registration.prepared.walk import BIN_LENGTH, bin_along_path, bin_means


def as_rough_as_here(numbers: Hyperparameters, everywhere: float, stretch: Survey, length: float) -> Hyperparameters:
    """Those of a stretch: beside a calm path its base expects a calm field, beside a rough one a rough one.

    ``everywhere``: the squared gradient of all paths. Noise is included in both, so that of a field too weak to be
    measured nothing is made.
    """
    here = squared_gradient([stretch], length)
    if min(here, everywhere) <= 0:
        return numbers
    return replace(numbers, prior_scale=numbers.prior_scale * float(np.sqrt(here / everywhere)))


def squared_gradient(surveys: Sequence[Survey], length: float, noise_sd: float = 0.0) -> float:
    """Mean square of an entry of the gradient along some paths, (T/m)^2, less what so much noise adds to it."""
    change2 = step2 = 0.0
    for survey in surveys:
        rows = bin_along_path(np.ascontiguousarray(survey.positions), BIN_LENGTH * length)
        x, b, n = bin_means(survey.positions, rows), bin_means(survey.field, rows), np.bincount(rows)
        # Bins next but one.
        noise2 = noise_sd**2 * (1 / n[2:] + 1 / n[:-2])
        change2 += float((((b[2:] - b[:-2]) ** 2).mean(axis=1) - noise2).sum())
        step2 += float(((x[2:] - x[:-2]) ** 2).sum())
    return change2 / step2 if step2 > 0 else 0.0
