# SPDX-License-Identifier: BSD-3-Clause
"""The exact Gaussian process is the textbook's."""

import numpy as np
import pytest

from magmatch.field.inducing.kernels import DivergenceFreeKernel
from oracles.dense import MAX_SAMPLES, DenseGP

KERNEL = DivergenceFreeKernel(0.6, 12e-6)
NOISE = 0.5e-6
EYE = np.eye(3)


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


def test_derivatives_are_finite_differences(samples, queries):
    gp = DenseGP.fit(KERNEL, *samples, NOISE, constant_sd=1e-4)
    h = 1e-4
    exact = gp.mean(queries, 2)
    gradient = np.stack(
        [(gp.mean(queries + h * e).field - gp.mean(queries - h * e).field) / (2 * h) for e in EYE], -1
    )
    second = np.stack(
        [(gp.mean(queries + h * e, 1).gradient - gp.mean(queries - h * e, 1).gradient) / (2 * h) for e in EYE], -1
    )
    # Central differences err by (h / l)^2, and by the rounding of a constant field of 100 uT over h.
    np.testing.assert_allclose(exact.gradient, gradient, atol=1e-6 * np.abs(gradient).max())
    np.testing.assert_allclose(exact.second, second, atol=1e-6 * np.abs(second).max())


def test_covariance_returns_to_the_prior_far_away(samples):
    far = np.array([[50.0, 0.0, 0.0]])
    gp = DenseGP.fit(KERNEL, *samples, NOISE)
    np.testing.assert_allclose(gp.covariance(far, 1)[0], KERNEL.at_one_point(1), rtol=1e-12)


def test_a_constant_field_is_found_and_kept_far_away(samples):
    points, _ = samples
    constant = np.array([20e-6, 5e-6, -45e-6])
    gp = DenseGP.fit(KERNEL, points, np.tile(constant, (40, 1)), NOISE, constant_sd=1e-4)
    far = gp.mean(np.array([[50.0, 0.0, 0.0]])).field[0]
    # The constant is known only as well as the average of a field with this lengthscale over two metres.
    np.testing.assert_allclose(far, constant, atol=0.05 * 45e-6)


def test_too_many_samples_are_refused_with_their_number():
    points = np.zeros((MAX_SAMPLES + 1, 3))
    with pytest.raises(ValueError, match=f"at most {MAX_SAMPLES} samples .* got {MAX_SAMPLES + 1}"):
        DenseGP.fit(KERNEL, points, points, NOISE)


def test_duplicates_without_noise_are_refused():
    points = np.zeros((3, 3))
    with pytest.raises(ValueError, match=r"not positive definite .* noise_sd"):
        DenseGP.fit(KERNEL, points, points, 0.0)
