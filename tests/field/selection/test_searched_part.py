# SPDX-License-Identifier: BSD-3-Clause
"""How much of a survey its evidence is computed from."""

import numpy as np

from magmatch.field.hyperparameters import Hyperparameters
from magmatch.field.selection.spline_hyperparameters import (
    PART_OPERATIONS,
    SMALLER_PART,
    search_part,
    search_smaller_part,
)

H = Hyperparameters(lengthscale=0.3, signal_sd=5e-6, noise_sd=3e-7, spacing=0.15)


def test_a_part_takes_most_of_the_operations_that_a_survey_of_its_size_may():
    n, rng = 16_000, np.random.default_rng(0)
    x = rng.uniform(0, 1, (n, 3)) * [6, 6, 1]
    b = 5e-6 * np.sin(3 * x)
    most = PART_OPERATIONS[0] + PART_OPERATIONS[1] * n
    part = search_part(x, b, H, is_path=False)
    assert 0.6 * most < part.operations(H) <= most
    smaller = search_smaller_part(x, b, H, part)
    assert 0.6 * SMALLER_PART < smaller.operations(H) / part.operations(H) <= SMALLER_PART
