# SPDX-License-Identifier: BSD-3-Clause
"""The published recursion: printed equations, order of samples, and what its variances do far away."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from magmatch.field.inducing.kernels import DivergenceFreeKernel
from oracles.dense import DenseGP
from oracles.recursive import RecursiveSparseGP

laws = settings(deadline=None, max_examples=10)
KERNEL = DivergenceFreeKernel(0.7, 12e-6)
NOISE = 0.8e-6
U = np.stack(np.meshgrid(*[np.array([-0.7, 0.0, 0.7])] * 3, indexing="ij"), axis=-1).reshape(-1, 3)


def samples_of(seed, n=30):
    rng = np.random.default_rng(seed)
    return rng.uniform(-0.8, 0.8, size=(n, 3)), rng.normal(scale=10e-6, size=(n, 3))


def as_printed(points, field, jitter):
    """Belief at U after the paper's corrected recursion, sample by sample, inverting K_U."""
    K_U = KERNEL.covariance(U, U) + jitter * KERNEL.signal_sd**2 * np.eye(3 * len(U))
    inverse = np.linalg.inv(K_U)
    mu, Sigma = np.zeros(len(K_U)), K_U.copy()
    for x, b in zip(points, field, strict=True):
        A = KERNEL.covariance(x[None], U) @ inverse
        S_bb = A @ Sigma @ A.T + NOISE**2 * np.eye(3)
        gain = (A @ Sigma).T @ np.linalg.inv(S_bb)
        mu, Sigma = mu + gain @ (b - A @ mu), Sigma - gain @ S_bb @ gain.T
    return inverse, mu, Sigma


def test_recursion_is_the_printed_one():
    points, field = samples_of(0)
    state = RecursiveSparseGP.start(KERNEL, U, NOISE, jitter=1e-9)
    for i in range(len(points)):
        state = state.update(points[i : i + 1], field[i : i + 1])
    inverse, mu, Sigma = as_printed(points, field, 1e-9)
    # The printed form inverts K_U; its condition here is about 1e5.
    np.testing.assert_allclose(state.inducing_mean, mu, atol=1e-8 * np.abs(mu).max())
    np.testing.assert_allclose(state.inducing_covariance, Sigma, atol=1e-8 * np.abs(Sigma).max())
    queries = samples_of(1, 5)[0]
    A = KERNEL.covariance(queries, U) @ inverse
    np.testing.assert_allclose(state.mean(queries).field, (A @ mu).reshape(3, 5).T, atol=1e-13)
    printed = (A @ Sigma @ A.T).reshape(3, 5, 3, 5)[:, range(5), :, range(5)]
    np.testing.assert_allclose(state.sor_covariance(queries), printed, atol=1e-8 * KERNEL.signal_sd**2)


@laws
@given(st.integers(0, 1000), st.integers(1, 29))
def test_order_and_blocks_of_samples_do_not_matter(seed, cut):
    points, field = samples_of(seed)
    start = RecursiveSparseGP.start(KERNEL, U, NOISE, constant_sd=1e-4)
    order = np.random.default_rng(seed).permutation(30)
    at_once = start.update(points, field)
    in_two = start.update(points[order[:cut]], field[order[:cut]]).update(points[order[cut:]], field[order[cut:]])
    np.testing.assert_allclose(in_two.inducing_mean, at_once.inducing_mean, atol=1e-8 * 12e-6)
    np.testing.assert_allclose(in_two.white_covariance, at_once.white_covariance, atol=1e-8)


def test_update_leaves_the_old_belief_alone():
    start = RecursiveSparseGP.start(KERNEL, U, NOISE)
    start.update(*samples_of(2))
    assert not start.white_mean.any()
    np.testing.assert_array_equal(start.white_covariance, np.eye(3 * len(U) + 3))


def test_inducing_points_at_the_samples_give_the_exact_model():
    points, field = samples_of(5)
    exact = DenseGP.fit(KERNEL, points, field, NOISE, constant_sd=1e-4)
    state = RecursiveSparseGP.start(KERNEL, points, NOISE, constant_sd=1e-4, jitter=1e-11).update(points, field)
    queries = samples_of(6, 9)[0]
    np.testing.assert_allclose(state.mean(queries).field, exact.mean(queries).field, atol=1e-6 * 1e-5)
    prior_constant = 1e-8 * np.eye(3)
    assert np.all(np.linalg.eigvalsh(prior_constant + KERNEL.at_one_point() - state.dtc_covariance(queries)) > 0)
    np.testing.assert_allclose(state.dtc_covariance(queries), exact.covariance(queries), atol=1e-6 * 144e-12)


def test_published_variance_vanishes_far_away_and_dtc_returns_to_the_prior():
    state = RecursiveSparseGP.start(KERNEL, U, NOISE).update(*samples_of(7))
    far = np.array([[30.0, 0.0, 0.0]])
    np.testing.assert_allclose(state.sor_covariance(far), 0, atol=1e-30)
    np.testing.assert_allclose(state.dtc_covariance(far)[0], KERNEL.at_one_point(), rtol=1e-12)


def test_derivatives_are_finite_differences():
    state = RecursiveSparseGP.start(KERNEL, U, NOISE).update(*samples_of(8))
    queries, h = samples_of(9, 4)[0], 1e-5
    for k, e in enumerate(np.eye(3)):
        up, down = state.mean(queries + h * e, 1), state.mean(queries - h * e, 1)
        exact = state.mean(queries, 2)
        np.testing.assert_allclose(exact.gradient[..., k], (up.field - down.field) / (2 * h), atol=1e-11)
        np.testing.assert_allclose(exact.second[..., k], (up.gradient - down.gradient) / (2 * h), atol=1e-11)


def test_noise_must_be_positive():
    with pytest.raises(ValueError, match="expected a positive noise_sd, got 0"):
        RecursiveSparseGP.start(KERNEL, U, 0.0)


def test_coinciding_inducing_points_are_refused_with_the_smallest_eigenvalue():
    with pytest.raises(ValueError, match=r"not positive definite .*smallest eigenvalue"):
        RecursiveSparseGP.start(KERNEL, np.concatenate([U, U]), NOISE, jitter=0.0)
