# SPDX-License-Identifier: BSD-3-Clause
"""The restricted likelihood is the textbook's, found by one tridiagonalisation per lengthscale."""

import numpy as np
import pytest

from magmatch.field.inducing.kernels import DivergenceFreeKernel
from magmatch.field.inducing.marginal_likelihood import NOISE_RATIOS, choose_samples, fit_at


def restricted_log_likelihood(kernel, points, field, signal_sd, noise_sd):
    """Up to a constant: density of the samples' contrasts, by an explicit basis of them."""
    n = len(points)
    basis = np.linalg.qr(np.hstack([np.ones((n, 1)), np.eye(n)[:, 1:]]))[0][:, 1:]
    contrasts = np.kron(np.eye(3), basis.T)
    C = signal_sd**2 * kernel.covariance(points, points) + noise_sd**2 * np.eye(3 * n)
    C, y = contrasts @ C @ contrasts.T, contrasts @ field.T.ravel()
    return -0.5 * (y @ np.linalg.solve(C, y) + np.linalg.slogdet(C)[1])


@pytest.fixture
def samples():
    rng = np.random.default_rng(0)
    return rng.uniform(size=(25, 3)), rng.normal(scale=10e-6, size=(25, 3)) + 40e-6


def test_best_signal_and_noise_maximise_the_restricted_likelihood(samples):
    points, field = samples
    kernel = DivergenceFreeKernel(0.3, 1.0)
    fit = fit_at(kernel, points, field)
    best = restricted_log_likelihood(kernel, points, field, fit.signal_sd, fit.noise_sd)
    step = np.sqrt(NOISE_RATIOS[1] / NOISE_RATIOS[0])
    for signal, noise in [(1.1, 1.1), (0.9, 0.9), (1.0, step), (1.0, 1 / step)]:
        other = restricted_log_likelihood(kernel, points, field, signal * fit.signal_sd, noise * fit.noise_sd)
        assert other < best


def test_differences_of_log_likelihood_are_exact(samples):
    points, field = samples
    kernels = [DivergenceFreeKernel(length, 1.0) for length in (0.2, 0.5)]
    fits = [fit_at(kernel, points, field) for kernel in kernels]
    explicit = [
        restricted_log_likelihood(k, points, field, f.signal_sd, f.noise_sd)
        for k, f in zip(kernels, fits, strict=True)
    ]
    assert fits[1].score - fits[0].score == pytest.approx(explicit[1] - explicit[0], rel=1e-8)


def test_chosen_samples_are_distinct_and_without_spikes():
    rng = np.random.default_rng(1)
    points = rng.uniform(size=(1000, 3))
    field = np.sin(3 * points) * 1e-5 + rng.normal(scale=1e-6, size=(1000, 3))
    spikes = rng.choice(1000, 30, replace=False)
    field[spikes] += 1e-3
    rows = choose_samples(points, field, 1000)
    assert len(np.unique(rows)) == len(rows)
    assert not np.isin(rows, spikes).any()
    assert len(rows) > 950
    np.testing.assert_array_equal(rows, choose_samples(points, field, 1000))
