# SPDX-License-Identifier: BSD-3-Clause
"""How far a layer of charges stands, its signal and noise: against dense evidence and refits without stretches."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.stats import multivariate_normal

from magmatch.field.equivalent_sources.shell import lay_shell
from magmatch.field.folds import Folds, divide
from magmatch.field.inducing.marginal_likelihood import ScaleFit, walk_uphill
from magmatch.field.priors.harmonic import fit_shell

laws = settings(deadline=None, max_examples=30)
NOISE = 0.4e-6


def samples(x, seed=0):
    """Earth's field, three charges below, and noise."""
    rng, field = np.random.default_rng(seed), np.array([18e-6, 2e-6, -44e-6]) + np.zeros_like(x)
    for at in rng.uniform([0, 0, -0.9], [1, 1, -0.6], (3, 3)):
        r = x - at
        field += 3e-6 * rng.normal() * r / np.linalg.norm(r, axis=1)[:, None] ** 3
    return field + NOISE * rng.normal(size=x.shape)


def columns(shell, x):
    """What the weights of unit prior variance do, and the constant field, a hundred times as free."""
    return np.hstack([shell.design(x), 100 * np.kron(np.eye(3), np.ones((len(x), 1)))])


def test_the_score_is_the_dense_evidence_at_the_best_level_of_signal_and_noise():
    x = np.random.default_rng(1).uniform(0, 1, (50, 3))
    b, folds = samples(x), Folds(np.zeros(50, dtype=int), (), False)

    def dense(A, ratio):
        """Log density at the level that suits it best, and the noise that this level makes."""
        C, y = np.eye(150) + A @ A.T / ratio, (b - b.mean(axis=0)).T.ravel()
        variance = y @ np.linalg.solve(C, y) / 150
        return multivariate_normal(None, variance * C, allow_singular=True).logpdf(y), np.sqrt(variance)

    scores = []
    for distance in (0.3, 0.6):
        shell = lay_shell(x, distance, distance / 2, 300)
        fit, A = fit_shell(shell, x, b, folds), columns(shell, x)
        ratio = (fit.noise_sd / fit.signal_sd) ** 2
        best, noise_sd = dense(A, ratio)
        assert fit.scale == shell.distance
        assert fit.noise_sd == pytest.approx(noise_sd, rel=1e-6)
        assert all(dense(A, factor * ratio)[0] < best for factor in (0.3, 3.0))
        scores.append((fit.score, best))
    assert scores[0][0] - scores[1][0] == pytest.approx(scores[0][1] - scores[1][1], abs=1e-3)


def test_along_a_path_the_score_is_what_refits_miss_of_stretches_they_did_not_see():
    s = np.linspace(0, 1, 300)[:, None]
    x = 0.5 + 0.5 * np.concatenate([np.sin(9 * s), np.cos(7 * s), 0.3 * np.sin(30 * s)], axis=1)
    b, folds = samples(x), divide(x, 0.3)
    assert folds.is_path
    shell = lay_shell(x, 0.5, 0.3, 200)
    fit, A = fit_shell(shell, x, b, folds), columns(shell, x).reshape(3, 300, -1)
    unit = np.abs(b - b.mean(axis=0)).max()
    y = ((b - b.mean(axis=0)) / unit).T

    def missed(ratio):
        """Mean root of the misses, of which few large ones do not dominate."""
        total = 0.0
        for out in folds.left_out:
            K, r = A[:, ~out].reshape(-1, A.shape[2]), y[:, ~out].ravel()
            w = np.linalg.solve(K.T @ K + ratio * np.eye(A.shape[2]), K.T @ r)
            total += np.sqrt(np.linalg.norm(A[:, out] @ w - y[:, out], axis=0)).mean()
        return total

    ratio = (fit.noise_sd / fit.signal_sd) ** 2
    assert fit.score == pytest.approx(-2 * np.log(missed(ratio)), rel=1e-5)
    assert min(missed(ratio / 6), missed(6 * ratio)) >= missed(ratio)


@pytest.mark.parametrize("is_path", [True, False])
def test_by_the_prior_a_far_layer_varies_at_the_samples_at_most_five_times_as_much_as_they_do(is_path):
    s = np.linspace(0, 6, 400)
    x = np.column_stack([3 * np.sin(3 * s), 3 * np.cos(2.3 * s), 0 * s])
    b = 1e-5 * np.stack([np.sin(3 * x[:, 1]), np.cos(3 * x[:, 0]), np.sin(3 * x[:, 0] + 2 * x[:, 1])], axis=1)
    shell, folds = lay_shell(x, 3.0, 1.5, 300), divide(x, 1.0)
    fit = fit_shell(shell, x, b, folds if is_path else Folds(folds.part, (), False))
    by_prior = fit.signal_sd * shell.design(x).reshape(3, len(x), -1)
    by_prior -= by_prior.mean(axis=1, keepdims=True)
    assert np.sqrt((by_prior**2).sum(axis=2).mean()) <= 5 * np.sqrt(b.var(axis=0).mean())


@laws
@given(best=st.floats(-2, 2), start=st.floats(-1, 1), low=st.floats(-1.5, -1), high=st.floats(1, 1.5))
def test_the_distance_of_the_best_score_is_found_within_bounds_in_few_fits(best, start, low, high):
    """Of a score with one top, in logarithms of the distance."""
    tried = []

    def fit_at(distance):
        tried.append(distance)
        return ScaleFit(distance, 1.0, 1.0, -((np.log(distance) - best) ** 2))

    found = walk_uphill(fit_at, np.exp(start), (np.exp(low), np.exp(high)), np.sqrt(2), 8, 1.3)
    nearest = np.clip(best, low, high)
    assert min(tried) >= np.exp(low) * (1 - 1e-12)
    assert max(tried) <= np.exp(high) * (1 + 1e-12)
    assert len(set(tried)) == len(tried) <= 14
    # Steps of the fourth root of two in the end, as far as eight of them go.
    assert abs(np.log(found.scale) - nearest) <= np.log(2) / 8 + 1e-9 or len(tried) >= 9
