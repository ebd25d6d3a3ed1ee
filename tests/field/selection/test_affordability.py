# SPDX-License-Identifier: BSD-3-Clause
"""What spacing a survey can afford."""

import numpy as np

from magmatch.field.hyperparameters import Hyperparameters
from magmatch.field.selection.affordability import affordable_spacing


def test_spacing_that_would_take_too_long_is_widened_with_a_word(caplog, monkeypatch):
    monkeypatch.setattr("magmatch.field.selection.affordability.MOST_OPERATIONS", (5e8, 1e5))
    x = np.random.default_rng(0).uniform(0, 30, (500, 3)) * [1, 1, 0.01]
    spacing = affordable_spacing(x, Hyperparameters(0.35, 1e-6, 1e-7, 0.1))
    assert spacing > 0.1
    assert "widened" in caplog.text
