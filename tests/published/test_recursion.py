# SPDX-License-Identifier: BSD-3-Clause
"""The published recursion: printed equations, order of samples, and what its variances do far away."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from magmatch.data.survey import Survey
from magmatch.errors import ConfigurationError
from magmatch.field.build import build_map
from magmatch.field.config import FieldConfig
from magmatch.field.inducing.inducing_prior import InducingPrior
from magmatch.field.inducing.kernels import DIVERGENCE_FREE, Kernel
from magmatch.published.recursion import RecursiveField, recursively

laws = settings(deadline=None, max_examples=10)
KERNEL = Kernel(DIVERGENCE_FREE, 0.7, 12e-6)
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
    state = RecursiveField.start(KERNEL, U, NOISE, jitter=1e-9)
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


def test_published_variance_vanishes_far_away_and_dtc_returns_to_the_prior():
    state = RecursiveField.start(KERNEL, U, NOISE).update(*samples_of(7))
    far = np.array([[30.0, 0.0, 0.0]])
    np.testing.assert_allclose(state.sor_covariance(far), 0, atol=1e-30)
    np.testing.assert_allclose(state.dtc_covariance(far)[0], KERNEL.at_one_point(), rtol=1e-12)


def test_noise_must_be_positive():
    with pytest.raises(ValueError, match="expected a positive noise_sd, got 0"):
        RecursiveField.start(KERNEL, U, 0.0)


def test_coinciding_inducing_points_are_refused_with_the_smallest_eigenvalue():
    with pytest.raises(ValueError, match=r"not positive definite .*smallest eigenvalue"):
        RecursiveField.start(KERNEL, np.concatenate([U, U]), NOISE, jitter=0.0)


@laws
@given(st.integers(0, 1000))
def test_one_sample_at_a_time_gives_what_all_at_once_give(seed):
    points, field = samples_of(seed)
    start = RecursiveField.start(KERNEL, U, NOISE, constant_sd=1e-4)
    one_by_one, at_once = start.update_each(points, field), start.update(points, field)
    np.testing.assert_allclose(one_by_one.inducing_mean, at_once.inducing_mean, atol=1e-8 * 12e-6)
    np.testing.assert_allclose(one_by_one.white_covariance, at_once.white_covariance, atol=1e-8)


@pytest.fixture(scope="module")
def batch():
    """A map of the published prior with a zero mean, all samples at once."""
    points, field = samples_of(10, 60)
    numbers = {"lengthscale": 0.7, "signal_sd": 12e-6, "noise_sd": NOISE, "spacing": 0.6}
    config = FieldConfig(prior="divergence_free", leave_out_outliers=False, **numbers)
    field_map = build_map(Survey(points, field), config)
    prior = InducingPrior("divergence_free", DIVERGENCE_FREE, DIVERGENCE_FREE, 1200, 0.0)
    p_model = field_map.survey.transformed(field_map.T_map_model.inv())
    model = prior.build(p_model.positions, p_model.field, field_map.hyperparameters)
    return replace(field_map, posterior=model.fit(p_model.positions, p_model.field, {}, map))


def test_a_map_inferred_recursively_is_the_batch_form_with_zero_mean(batch):
    found, queries = recursively(batch), samples_of(11, 20)[0]
    for one, other in (
        (getattr(m.evaluate(queries, 2), name) for m in (found, batch)) for name in ("field", "gradient", "second")
    ):
        np.testing.assert_allclose(one, other, atol=1e-6 * np.abs(other).max())
    # The printed variance lacks what the inducing points cannot represent.
    lacking = np.linalg.eigvalsh(batch.covariance(queries) - found.covariance(queries))
    assert lacking.min() > -1e-6 * 144e-12
    assert np.abs(found.covariance([[50.0, 0, 0]])).max() < 1e-30 < batch.covariance([[50.0, 0, 0]]).max()


def test_a_map_of_another_prior_cannot_be_inferred_recursively(batch):
    other = replace(batch, config=batch.config.model_copy(update={"prior": "spline"}))
    with pytest.raises(ConfigurationError, match="of the prior 'divergence_free', got a map of 'spline'"):
        recursively(other)


def test_a_map_inferred_recursively_is_neither_saved_nor_grown_as_another_posterior(batch, tmp_path):
    found = recursively(batch)
    with pytest.raises(ConfigurationError, match="neither saved nor grown"):
        found.save(tmp_path / "recursive.map")
    assert not list(tmp_path.iterdir())
    with pytest.raises(ConfigurationError, match="neither saved nor grown"):
        found.without_samples(np.arange(len(found.survey)) < 3)
