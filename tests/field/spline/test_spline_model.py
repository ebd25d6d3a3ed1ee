# SPDX-License-Identifier: BSD-3-Clause
"""The spline prior as a field model: laws of inference and physics, derivatives, calibration, failures."""

from dataclasses import replace

import numpy as np
import pytest

from dipoles import dipoles
from magmatch.field.hyperparameters import Hyperparameters
from magmatch.field.priors import PRIORS
from magmatch.field.spline.spline_model import SplineModel
from oracles.dense_matrix import to_dense

H = Hyperparameters(0.5, 1e-5, 5e-7, 0.2, 300.0)
EARTH = np.array([18e-6, 3e-6, -45e-6])


def dipole_field(x, seed=0, n=30):
    """Exact field (T) of dipoles below and beside the box 0..2 x 0..2 x 0..0.5 m."""
    rng = np.random.default_rng(seed)
    source = np.c_[rng.uniform(-0.5, 2.5, (n, 2)), rng.uniform(-1.2, -0.5, n)]
    return EARTH + dipoles(x, source, 1e-6 * rng.normal(size=(n, 3)))


def room(n=600, seed=0, noise=3e-7):
    rng = np.random.default_rng(seed)
    x = rng.uniform(0, [2, 2, 0.5], (n, 3))
    return x, dipole_field(x) + noise * rng.normal(size=(n, 3))


@pytest.fixture(scope="module")
def fitted():
    x, b = room()
    model = SplineModel.over(x, H)
    return model, model.infer(model.observe(x, b)), x, b


def test_inference_equals_dense_bayesian_regression(fitted):
    model, _, x, b = fitted
    few_points = slice(0, 40)
    information = model.observe(x[few_points], b[few_points])
    small = model.infer(information)
    q = np.array([[0.3, 1.1, 0.2], [1.9, 0.1, 0.4]])
    rows = np.array([small.evaluate(np.r_[x[few_points], q], 0, w).field for w in np.eye(len(small.weights))])
    Phi = rows.reshape(len(small.weights), -1).T
    prior = np.linalg.inv(to_dense(model.prior_precision(), model.cells)) * H.noise_sd**2
    K = Phi @ prior @ Phi.T
    n = 120
    gain = K[n:, :n] @ np.linalg.inv(K[:n, :n] + H.noise_sd**2 * np.eye(n))
    np.testing.assert_allclose(small.evaluate(q).field.ravel(), gain @ b[few_points].ravel(), atol=1e-10)
    covariance = K[n:, n:] - gain @ K[:n, n:]
    np.testing.assert_allclose(small.covariance(q)[0], covariance[:3, :3], rtol=0, atol=1e-5 * covariance.max())
    # To a thousandth.
    np.testing.assert_allclose(H.noise_sd**2 * small.influence(q), covariance, atol=1e-3 * covariance.max())


@pytest.mark.parametrize("order", [0, 1])
def test_few_points_by_solves_and_many_by_the_selected_inverse_agree(fitted, order):
    model, _, x, b = fitted
    posterior, q = model.infer(model.observe(x, b)), np.r_[x[:5] + 0.01, [[40.0, 0.0, 0.0]]]
    by_solves = posterior.covariance(q, order)
    assert "_selected_inverse" not in vars(posterior)
    many = posterior.covariance(np.tile(q, (400, 1)), order)
    assert "_selected_inverse" in vars(posterior)
    np.testing.assert_allclose(by_solves, many[:6], atol=1e-9 * by_solves.max())
    assert np.array_equal(by_solves, posterior.covariance(q, order))


def test_no_points_have_no_covariance(fitted):
    nothing = np.zeros((0, 3))
    assert fitted[1].covariance(nothing, 1).shape == (0, 12, 12)
    assert fitted[1].influence(nothing).shape == (0, 0)


def test_weights_scale_each_sample_as_repetition_does(fitted):
    model, _, x, b = fitted
    doubled = model.observe(x, b, np.full(len(x), 2.0))
    twice = model.observe(np.r_[x, x], np.r_[b, b])
    np.testing.assert_allclose(doubled.eta, twice.eta, rtol=1e-10, atol=1e-18)
    np.testing.assert_allclose(doubled.gram.stencil, twice.gram.stencil, rtol=1e-10, atol=1e-12)


def test_inflation_scales_covariance_and_draws_but_not_the_mean(fitted):
    model, posterior, x, b = fitted
    wide = SplineModel(replace(H, inflation=2.0), model.elimination)
    other = wide.infer(wide.observe(x, b))
    assert np.array_equal(other.weights, posterior.weights)
    np.testing.assert_allclose(other.covariance(x[:5]), 4 * posterior.covariance(x[:5]), rtol=1e-12)
    spread, usual = (p.draw_weights(1, np.random.default_rng(0)) - p.weights for p in (other, posterior))
    np.testing.assert_allclose(spread, 2 * usual, atol=1e-18)


def test_far_from_data_the_field_is_the_constant_with_its_variance_and_the_prior_s(fitted):
    model, posterior, x, b = fitted
    far = np.array([[50.0, 0.0, 0.0]])
    assert not posterior.knows(far)[0]
    assert posterior.knows(x).all()
    assert np.array_equal(posterior.evaluate(far).field[0], posterior.weights[-3:])
    precision = to_dense(model.observe(x, b).gram + model.prior_precision(), model.cells)
    constant = np.linalg.inv(precision)[-3:, -3:] * (H.inflation * H.noise_sd) ** 2
    expected = constant + H.signal_sd**2 * np.eye(3)
    np.testing.assert_allclose(posterior.covariance(far)[0], expected, atol=1e-6 * H.signal_sd**2)
    # The gradient is symmetric: three of its directions do not vary.
    values = np.linalg.eigvalsh(posterior.covariance(far, 1)[0])
    np.testing.assert_allclose(values[:3], 0, atol=1e-12 * values[-1])
    assert values[3] > 0


def test_chosen_hyperparameters_recover_a_dipole_room():
    x, b = room(1000)
    prior = PRIORS["spline"]
    h = prior.choose_hyperparameters(x, b)
    assert h == prior.choose_hyperparameters(x, b)
    model = prior.build(x, b, h)
    posterior = model.infer(model.observe(x, b))
    q = np.random.default_rng(5).uniform(0, [2, 2, 0.5], (1500, 3))
    error = posterior.evaluate(q).field - dipole_field(q)
    assert np.sqrt((error**2).sum(axis=1).mean()) < 4e-7
    assert 1.5e-7 < h.noise_sd < 6e-7
    sd = np.sqrt(np.diagonal(posterior.covariance(q), axis1=1, axis2=2))
    assert 0.9 < np.mean(np.abs(error) < 1.96 * sd) <= 1.0


def test_a_survey_of_few_samples_leaves_no_gaps_and_costs_no_more_than_one_of_many():
    h, operations = {}, {}
    for n in (150, 1500):
        x, b = room(n)
        h[n] = PRIORS["spline"].choose_hyperparameters(x, b)
        model = PRIORS["spline"].build(x, b, h[n])
        operations[n] = model.elimination.n_operations
        between = np.random.default_rng(1).uniform(0, [2, 2, 0.5], (1000, 3))
        assert model.infer(model.observe(x, b)).knows(between).mean() > 0.98
    assert operations[150] < 1.5 * operations[1500]
    assert h[150].spacing > h[1500].spacing


def test_above_a_plane_the_field_is_told_as_far_as_its_lengthscale_says():
    rng = np.random.default_rng(3)
    x = np.c_[rng.uniform(0, 3, (1500, 2)), 0.3 + 0.005 * rng.normal(size=1500)]
    b = dipole_field(x, 3, 8) + 3e-7 * rng.normal(size=x.shape)
    h = PRIORS["spline"].choose_hyperparameters(x, b)
    assert 1.5 * h.spacing < 0.5 * h.lengthscale  # the usual reach would not do
    model = PRIORS["spline"].build(x, b, h)
    above = np.c_[rng.uniform(0.2, 1.8, (200, 2)), np.full(200, 0.3 + 0.5 * h.lengthscale)]
    assert model.infer(model.observe(x, b)).knows(above).all()
