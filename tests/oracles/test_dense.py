# SPDX-License-Identifier: BSD-3-Clause
"""The exact Gaussian process is the textbook's."""

import numpy as np
import pytest

from magmatch.field.inducing.kernels import DivergenceFreeKernel
from oracles.dense import MAX_SAMPLES, DenseGP

KERNEL = DivergenceFreeKernel(0.6, 12e-6)
NOISE = 0.5e-6


@pytest.fixture
def samples():
    rng = np.random.default_rng(3)
    return rng.uniform(-1, 1, size=(40, 3)), rng.normal(scale=10e-6, size=(40, 3))


@pytest.fixture
def queries():
    return np.random.default_rng(4).uniform(-1.2, 1.2, size=(7, 3))


def test_mean_and_covariance_are_the_textbook_formulas(samples, queries):
    points, field = samples
    C = KERNEL.covariance(points, points) + NOISE**2 * np.eye(120)
    K = KERNEL.covariance(queries, points)
    gp = DenseGP.fit(KERNEL, points, field, NOISE)
    expected = K @ np.linalg.solve(C, field.T.ravel())
    np.testing.assert_allclose(gp.mean(queries).field, expected.reshape(3, 7).T, rtol=1e-9)
    joint = KERNEL.covariance(queries, queries) - K @ np.linalg.solve(C, K.T)
    marginal = joint.reshape(3, 7, 3, 7)[:, range(7), :, range(7)]
    np.testing.assert_allclose(gp.covariance(queries), marginal, atol=1e-9 * KERNEL.signal_sd**2)


def test_too_many_samples_are_refused_with_their_number():
    points = np.zeros((MAX_SAMPLES + 1, 3))
    with pytest.raises(ValueError, match=f"at most {MAX_SAMPLES} samples .* got {MAX_SAMPLES + 1}"):
        DenseGP.fit(KERNEL, points, points, NOISE)


def test_duplicates_without_noise_are_refused():
    points = np.zeros((3, 3))
    with pytest.raises(ValueError, match=r"not positive definite .* noise_sd"):
        DenseGP.fit(KERNEL, points, points, 0.0)
