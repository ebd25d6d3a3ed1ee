# SPDX-License-Identifier: BSD-3-Clause
"""What one pass of a path misses of another, and how much of a survey its evidence is computed from."""

import numpy as np
import pytest

from magmatch.field.hyperparameters import Hyperparameters
from magmatch.field.selection.spline_evidence import EvidenceSearch
from magmatch.field.selection.spline_hyperparameters import (
    PART_OPERATIONS,
    SMALLER_PART,
    HeldOutErrors,
    cross_validate_path,
    expecting,
    search_part,
    search_smaller_part,
)  # fmt: skip
from magmatch.field.spline.spline_model import SplineModel


def test_errors_between_passes_hold_the_offset_of_a_lap():
    turn = np.linspace(0, 8 * np.pi, 1600)
    x = np.stack([3 * np.cos(turn), 3 * np.sin(turn), 0 * turn], axis=1)
    b = 1e-6 * np.stack([np.cos(2 * turn), np.sin(turn), 0 * turn], axis=1)
    lap = (turn // (2 * np.pi)).astype(int) % 2
    b += 2e-6 * lap[:, None]
    h = Hyperparameters(1.0, 1e-6, 0.3e-6, 0.5, divergence_weight=30.0)
    missed = cross_validate_path(EvidenceSearch(x, b, np.arange(len(x)), np.float32), h, 1.0)
    # Laps differ by 2 uT a component; a stretch left out is predicted from laps of both kinds.
    assert 0.7e-6 < missed.size < 2.1e-6
    assert missed.inflation(1e-9) > missed.inflation(2e-6)


@pytest.mark.parametrize("factor", [2.0, 4.0])
def test_the_inflation_is_the_factor_by_which_errors_exceed_what_was_said(factor):
    rng = np.random.default_rng(0)
    variances, noise = rng.uniform(0.5, 2.0, (20_000, 3)), 0.3
    errors = rng.normal(size=variances.shape) * np.sqrt(noise**2 + factor**2 * variances)
    found = HeldOutErrors(errors, variances, np.ones(len(errors), dtype=bool)).inflation(noise)
    # Factors are tried in steps of 16 %; the least that covers 95 % is taken.
    assert 0.98 * factor < found < 1.18 * factor


def test_only_errors_near_other_passes_count_and_few_large_ones_do_not_dominate():
    errors = np.ones((100, 3))
    errors[50:] = 1e3
    is_near = np.arange(100) < 50
    assert HeldOutErrors(errors, errors**2, is_near).size == pytest.approx(1.0)
    errors[0] = 100.0
    # The mean of the roots, squared: (49 + 10) / 50.
    assert HeldOutErrors(errors, errors**2, is_near).size == pytest.approx((59 / 50) ** 2)


def test_a_path_too_short_to_leave_any_of_it_out_is_not_validated():
    x = np.zeros((5, 3))
    search = EvidenceSearch(x, np.zeros((5, 3)), np.arange(5), np.float32)
    assert cross_validate_path(search, Hyperparameters(1.0, 1e-6, 1e-7, 0.5), 1.0) is None


def test_what_is_expected_elsewhere_widens_the_posterior_by_the_inflation_and_leaves_the_mean():
    x = np.random.default_rng(3).uniform(0, 1, (80, 3))
    b, evident = 1e-6 * np.sin(3 * x), 0.2e-6
    h = Hyperparameters(0.6, 1e-6, 0.1e-6, 0.3, divergence_weight=30.0)
    missed = HeldOutErrors(np.full((50, 3), 1e-6), np.full((50, 3), 0.1e-12), np.ones(50, dtype=bool))
    wide = expecting(h, evident, missed)
    assert wide.noise_sd == pytest.approx(1e-6)
    models = [SplineModel.over(x, numbers) for numbers in (h.with_noise(evident), wide)]
    before, after = (model.infer(model.observe(x, b)) for model in models)
    # The constant's prior does not scale along.
    np.testing.assert_allclose(after.evaluate(x).field, before.evaluate(x).field, rtol=1e-3)
    factor = missed.inflation(wide.noise_sd)
    expected = factor**2 * before.covariance(x[:5])
    np.testing.assert_allclose(after.covariance(x[:5]), expected, atol=1e-2 * expected.max())


def test_a_part_takes_most_of_the_operations_that_a_survey_of_its_size_may():
    n, rng = 16_000, np.random.default_rng(0)
    h = Hyperparameters(lengthscale=0.3, signal_sd=5e-6, noise_sd=3e-7, spacing=0.15)
    x = rng.uniform(0, 1, (n, 3)) * [6, 6, 1]
    b = 5e-6 * np.sin(3 * x)
    most = PART_OPERATIONS[0] + PART_OPERATIONS[1] * n
    part = search_part(x, b, h, is_path=False)
    assert 0.6 * most < part.operations(h) <= most
    smaller = search_smaller_part(x, b, h, part)
    assert 0.6 * SMALLER_PART < smaller.operations(h) / part.operations(h) <= SMALLER_PART
