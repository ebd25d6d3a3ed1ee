# SPDX-License-Identifier: BSD-3-Clause
"""The restricted likelihood is the textbook's, found by one tridiagonalisation per lengthscale."""

import numpy as np
import pytest

from magmatch.field.inducing.kernels import DIVERGENCE_FREE, Kernel
from magmatch.field.inducing.marginal_likelihood import NOISE_RATIOS, fit_at


def restricted_log_likelihood(kernel, points, field, signal_sd, noise_sd):
    """Up to a constant: density of the samples' contrasts, by an explicit basis of them."""
    n = len(points)
    basis = np.linalg.qr(np.hstack([np.ones((n, 1)), np.eye(n)[:, 1:]]))[0][:, 1:]
    contrasts = np.kron(np.eye(3), basis.T)
    C = signal_sd**2 * kernel.covariance(points, points) + noise_sd**2 * np.eye(3 * n)
    C, y = contrasts @ C @ contrasts.T, contrasts @ field.T.ravel()
    return -0.5 * (y @ np.linalg.solve(C, y) + np.linalg.slogdet(C)[1])


def test_best_signal_and_noise_maximise_the_restricted_likelihood_whose_differences_are_exact():
    rng = np.random.default_rng(0)
    points, field = rng.uniform(size=(25, 3)), rng.normal(scale=10e-6, size=(25, 3)) + 40e-6
    step, best = np.sqrt(NOISE_RATIOS[1] / NOISE_RATIOS[0]), []
    kernels = [Kernel(DIVERGENCE_FREE, length, 1.0) for length in (0.2, 0.5)]
    fits = [fit_at(kernel, points, field) for kernel in kernels]
    for kernel, fit in zip(kernels, fits, strict=True):

        def explicit(signal, noise, kernel=kernel, fit=fit):
            return restricted_log_likelihood(kernel, points, field, signal * fit.signal_sd, noise * fit.noise_sd)

        best.append(explicit(1.0, 1.0))
        assert max(explicit(1.1, 1.1), explicit(0.9, 0.9), explicit(1.0, step), explicit(1.0, 1 / step)) < best[-1]
    assert fits[1].score - fits[0].score == pytest.approx(best[1] - best[0], rel=1e-8)
