# SPDX-License-Identifier: BSD-3-Clause
"""How closely splines lie, what spacing can be afforded, and how far beyond the samples they reach."""

from dataclasses import replace

import numpy as np
import pytest

from magmatch.field.hyperparameters import Hyperparameters
from magmatch.field.selection.spline_layout import SplineLayout, affordable_spacing, is_affordable
from magmatch.field.tiles.region_model import fit_operations

H = Hyperparameters(1.0, 1e-6, 1e-7, 0.2, divergence_weight=3000.0, reach=1.5)


def box(n, height, seed=0):
    return np.random.default_rng(seed).uniform(0, [3, 3, height], (n, 3))


def test_where_not_all_of_the_extrapolation_can_be_afforded_a_part_is(monkeypatch):
    plane = box(500, 0.02)
    layout = SplineLayout.over(plane)
    for most, expected in ((3.6, 3.5), (3.4, 0.8 * 3.5), (2.7, 0.65 * 3.5), (2.0, H.reach)):
        monkeypatch.setattr(
            "magmatch.field.selection.spline_layout.is_affordable", lambda _, h, __, most=most: h.reach <= most
        )
        assert layout.extrapolating(plane, H).reach == pytest.approx(expected, rel=0.01)


def test_spacing_that_would_take_too_long_is_widened_with_a_word(caplog, monkeypatch):
    monkeypatch.setattr("magmatch.field.selection.spline_layout.MOST_OPERATIONS", (5e8, 1e5))
    x = np.random.default_rng(0).uniform(0, 30, (500, 3)) * [1, 1, 0.01]
    spacing = affordable_spacing(x, Hyperparameters(0.35, 1e-6, 1e-7, 0.1))
    assert spacing > 0.1
    assert "widened" in caplog.text


def test_a_survey_affords_what_its_number_of_samples_allows_and_no_wider_spacing_than_it_must(monkeypatch):
    x, h = np.random.default_rng(1).uniform(0, 3, (400, 3)), Hyperparameters(0.5, 1e-6, 1e-7, 0.25)
    share = fit_operations(x, h) / (4e9 + 2e5 * 400)
    assert is_affordable(x, h, 1.01 * share)
    assert not is_affordable(x, h, 0.99 * share)
    monkeypatch.setattr("magmatch.field.selection.spline_layout.MOST_OPERATIONS", (1e7, 1e5))
    spacing = affordable_spacing(x, h)
    costs = [fit_operations(x, replace(h, lengthscale=2 * s, spacing=s)) for s in (spacing, spacing / 1.25)]
    assert costs[0] <= 1e7 + 400e5 < costs[1]
    # A field that nobody could lay cells over is not asked what it costs.
    assert not is_affordable(1e4 * x, h, 1e30)
