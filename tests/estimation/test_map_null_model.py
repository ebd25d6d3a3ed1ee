# SPDX-License-Identifier: BSD-3-Clause
"""What unrelated fields look like: dense normal densities, and odds that are no better than even under the null."""

from dataclasses import replace
from itertools import product

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.stats import multivariate_normal

from magmatch.estimation.map_null_model import FACTORS, ROUGH_SHARE, CellMeans, NullModel, UnrelatedField
from magmatch.threads import one_blas_thread

RNG = np.random.default_rng(0)


def cells_of(n, seed=0):
    centers = np.random.default_rng(seed).uniform(0, 3, (n, 3))
    return CellMeans(np.arange(n), np.ones(n), centers)


def rational_quadratic(centers, length, variance):
    d2 = ((centers[:, None] - centers) ** 2).sum(axis=2)
    return variance / (1 + d2 / (2 * length**2))


def model_of(n=12, noise=1e-14, variance=2.5e-11, length=0.5, roughness=0.0, seed=0):
    cells = cells_of(n, seed)
    K = rational_quadratic(cells.centers, length, variance)
    field = np.linalg.cholesky(K + noise * np.eye(n)) @ np.random.default_rng(seed).standard_normal((n, 3))
    return NullModel(cells, 3e-5 + field, K, np.full(n, noise), roughness)


def most_likely(cells, field, noise):
    return UnrelatedField.most_likely(cells, field, noise, 0.6).over(cells, field, noise)


def test_the_most_likely_field_is_chosen_by_its_density_about_its_most_likely_constant():
    rng = np.random.default_rng(1)
    cells, noise = cells_of(14, 2), np.full(14, 2e-14) * np.random.default_rng(3).uniform(0.5, 2, 14)
    K = rational_quadratic(cells.centers, 0.9, 3e-11)
    field = 4e-5 + np.linalg.cholesky(K) @ rng.standard_normal((14, 3))
    variance, tried = field.var(axis=0).mean(), {}
    for factor, strength, rough in product(FACTORS, FACTORS, [0.0, *(ROUGH_SHARE * FACTORS)]):
        C = rational_quadratic(cells.centers, factor * 0.6, strength**2 * variance)
        total = C + np.diag(noise + rough**2 * variance)
        weights = np.linalg.solve(total, np.ones(14))
        left = field - weights @ field / weights.sum()
        density = multivariate_normal(np.zeros(14), 1e12 * total).logpdf(1e6 * left.T).sum()
        tried[density] = C, rough**2 * variance
    found = most_likely(cells, field, noise)
    np.testing.assert_allclose(found.covariance, tried[max(tried)][0], rtol=1e-9)
    assert found.roughness == pytest.approx(tried[max(tried)][1])


def test_a_constant_field_more_changes_nothing():
    cells, noise = cells_of(10), np.full(10, 1e-14)
    field = 5e-6 * RNG.standard_normal((10, 3))
    one, other = (most_likely(cells, field + c, noise) for c in (0.0, 7e-5))
    np.testing.assert_allclose(one.covariance, other.covariance, rtol=1e-6)
    model = replace(model_of(), roughness=1e-13)
    residual, extra, rows = 1e-7 * RNG.standard_normal((12, 3)), np.full(12, 1e-15), np.arange(12)
    shifted = replace(model, field=model.field + 7e-5)
    assert shifted.log_ratio(residual, extra, rows)[0] == pytest.approx(model.log_ratio(residual, extra, rows)[0])


def test_odds_of_one_cell_are_those_of_two_normal_densities_mixed_with_outliers():
    """Two cells: their difference is the one mode that the constant leaves."""
    noise, strong = 1e-14, 4e-11
    cells = CellMeans(np.arange(2), np.ones(2), np.array([[0, 0, 0], [50.0, 0, 0]]))
    field = np.array([[6e-6, -2e-6, 1e-6], [-6e-6, 2e-6, -1e-6]])
    model = NullModel(cells, field, strong * np.eye(2), np.full(2, noise), 0.0)
    residual = np.array([[1e-7, 0, 0], [0, -1e-7, 0]])
    found = model.log_ratio(residual, np.zeros(2), np.arange(2))
    strengths = unexplained = np.geomspace(1e-4, 10, 21)
    # Modes of equal cells: any two that are orthogonal; their sum of squares is what counts.
    b2, r2 = (((v / np.sqrt(noise)) ** 2).sum(axis=1) for v in (field, residual))
    k_all = strong / noise * strengths[:, None] + 1
    k = strong / noise * strengths[np.argmax(-(b2 / (2 * k_all) + 1.5 * np.log(k_all)).sum(axis=1))] + 1
    # All levels of what may stay unexplained are averaged over; with no residuals at all, the most is reached.
    for odds, left in zip(found, (r2, 0 * r2), strict=True):
        each = []
        for s in unexplained:
            v = min(k, 1 + s * field.var(axis=0).mean() / noise)
            L = np.minimum(b2, 9 * k) / (2 * k) - left / (2 * v) + 1.5 * np.log(k / v)
            each.append(np.prod(0.1 + 0.9 * np.exp(L)) if v < 0.8 * k else 1.0)
        assert odds == pytest.approx(np.log(np.mean(each)), rel=1e-9)


# From one mode to many, rough fields and smooth ones, faint ones and ones far above the noise.
N_DRAWS = 400


@pytest.mark.parametrize(
    ("n", "length", "noise"), [(2, 0.3, 1e-14), (2, 1.5, 3e-12), (5, 0.3, 3e-12), (30, 1.5, 1e-14), (30, 0.3, 3e-12)]
)
def test_under_the_null_odds_are_one_at_most_on_average(n, length, noise):
    """Fields drawn from the null model, against predictions that know nothing of them: E[ratio] <= 1.

    The bound is three standard errors of the mean of 400 draws; by Markov's inequality, also a ratio above 20 comes
    once in twenty draws at most.
    """
    cells, rng = cells_of(n), np.random.default_rng(n)
    K = rational_quadratic(cells.centers, length, 2.5e-11)
    root = np.linalg.cholesky(K + noise * np.eye(n))
    exact = np.linalg.cholesky(K + 1e-9 * np.trace(K) / n * np.eye(n))
    earth = np.array([18e-6, 3e-6, -45e-6])
    predictions = {
        "nothing": lambda: np.zeros((n, 3)),
        "the constant": lambda: np.tile(earth, (n, 1)),
        "another field": lambda: earth + exact @ rng.standard_normal((n, 3)),
        "a faint one": lambda: earth + 0.3 * exact @ rng.standard_normal((n, 3)),
    }
    model = NullModel(cells, np.zeros((n, 3)), K, np.full(n, noise), 0.0)
    with one_blas_thread():
        for name, predict in predictions.items():
            ratios = []
            for _ in range(N_DRAWS):
                field = earth + root @ rng.standard_normal((n, 3))
                drawn = replace(model, field=field)
                ratios.append(np.exp(drawn.log_ratio(field - predict(), np.zeros(n), np.arange(n))[0]))
            error = np.std(ratios) / np.sqrt(N_DRAWS)
            assert np.mean(ratios) + 3 * error <= 1, name
            assert np.mean(np.array(ratios) > 20) <= 1 / 20, name


@given(seed=st.integers(0, 2**32 - 1), size=st.floats(1e-9, 1e-4), extra=st.floats(0, 1e-11), n=st.integers(2, 15))
def test_odds_never_exceed_those_without_residuals(seed, size, extra, n):
    rng = np.random.default_rng(seed)
    model = model_of(n, seed=seed % 1000)
    residual = size * rng.standard_normal((n, 3))
    odds, attainable = model.log_ratio(residual, np.full(n, extra), np.arange(n))
    assert odds <= attainable
    assert model.log_ratio(0 * residual, np.full(n, extra), np.arange(n)) == pytest.approx((attainable, attainable))


def test_less_residual_is_never_less_odds_and_an_uncertain_base_counts_less():
    model, rows = model_of(20, seed=4), np.arange(20)
    residual = 2e-7 * np.random.default_rng(5).standard_normal((20, 3))
    odds = [model.log_ratio(s * residual, np.zeros(20), rows)[0] for s in (10.0, 3.0, 1.0, 0.3, 0.0)]
    assert odds == sorted(odds)
    assert odds[-1] > odds[0] + 100
    unsure = [model.log_ratio(0 * residual, np.full(20, v), rows)[0] for v in (0.0, 1e-12, 1e-9)]
    assert unsure == sorted(unsure, reverse=True)
    assert abs(unsure[-1]) < 1
