# SPDX-License-Identifier: BSD-3-Clause
"""What every prior's posterior says at points and on grids, against dense algebra, draws and differences."""

import numpy as np
import pytest
from scipy.spatial.transform import RigidTransform, Rotation

from magmatch.data.survey import Survey
from magmatch.field.build import build_map
from magmatch.field.config import FieldConfig
from magmatch.field.hyperparameters import Hyperparameters
from magmatch.field.priors import PRIORS
from magmatch.field.spline.spline_model import SplineModel, SplinePosterior
from oracles.dense_matrix import to_dense

H = Hyperparameters(0.5, 1e-5, 5e-7, 0.3, 100.0)
FAR = np.array([[40.0, 0.0, 0.0], [-40.0, 5.0, 0.0]])


def samples(n=200, seed=0):
    rng = np.random.default_rng(seed)
    x = rng.uniform(0, [1.5, 1.5, 0.6], (n, 3))
    return x, 1e-5 * np.c_[np.sin(2 * x[:, 0]), np.cos(3 * x[:, 1]), x[:, 2]] + 5e-7 * rng.normal(size=x.shape)


@pytest.fixture(scope="module", params=sorted(PRIORS))
def posterior(request):
    x, b = samples()
    model = PRIORS[request.param].build(x, b, H)
    return model.infer(model.observe(x, b))


def queries(n=7, seed=3):
    return np.random.default_rng(seed).uniform(0.1, [1.4, 1.4, 0.5], (n, 3))


def test_covariance_of_the_gradient_comes_with_that_of_the_field(posterior):
    q = np.r_[queries(), FAR]
    own, both = posterior.covariance(q), posterior.covariance(q, 1)
    assert both.shape == (9, 12, 12)
    np.testing.assert_allclose(both[:, :3, :3], own, atol=1e-8 * own.max())


def test_draws_spread_no_wider_than_the_covariance_says_and_those_of_a_spline_as_wide(posterior):
    q = queries(5)
    draws = [posterior.evaluate(q, 0, w).field for w in posterior.draw_weights(1500, np.random.default_rng(1))]
    ratio = np.var(draws, axis=0) / np.diagonal(posterior.covariance(q), axis1=1, axis2=2)
    # 1,500 draws give a variance to 3.7 %.
    assert ratio.max() < 1.12
    # Draws of others leave out what lies between the nodes.
    assert ratio.min() > (0.88 if isinstance(posterior, SplinePosterior) else 0.02)


def test_without_factors_the_mean_is_the_same(posterior):
    q, mean = np.r_[queries(), FAR], posterior.without_factors()
    for order in (0, 1):
        np.testing.assert_array_equal(mean.evaluate(q, order).field, posterior.evaluate(q, order).field)
    np.testing.assert_array_equal(mean.evaluate(q, 1).gradient, posterior.evaluate(q, 1).gradient)
    if isinstance(posterior, SplinePosterior):
        with pytest.raises(RuntimeError, match="factors of this posterior are not kept"):
            mean.covariance(q)


@pytest.mark.parametrize("prior", sorted(PRIORS))
@pytest.mark.parametrize("box", [None, (0.0, 0.0, 0.0, 1.2, 1.2, 0.5)])
def test_covariances_turn_with_the_map(prior, box):
    x, b = samples()
    numbers = {"lengthscale": 0.5, "signal_sd": 1e-5, "noise_sd": 5e-7, "spacing": 0.3}
    field_map = build_map(Survey(x, b), FieldConfig(prior=prior, domain=box, **numbers))
    T = RigidTransform.from_components([1.0, -2.0, 0.5], Rotation.from_rotvec([0.3, -1.1, 0.7]))
    moved, q = field_map.transformed(T), np.r_[queries(), FAR]
    R = T.rotation.as_matrix()
    both = np.zeros((12, 12))
    both[:3, :3], both[3:, 3:] = R, np.kron(R, R)
    for turn, order in ((R, 0), (both, 1)):
        expected = turn @ field_map.covariance(q, order) @ turn.T
        np.testing.assert_allclose(moved.covariance(T.apply(q), order), expected, atol=1e-7 * expected.max())


@pytest.fixture(scope="module")
def spline():
    x, b = samples()
    model = SplineModel.over(x, H)
    return model, model.infer(model.observe(x, b))


def test_solves_equal_the_dense_inverse(spline):
    model, fitted = spline
    x, b = samples()
    precision = to_dense(model.observe(x, b).gram + model.prior_precision(), model.cells)
    q = np.r_[queries(30), FAR[:1]]
    Phi = np.array([fitted.evaluate(q, 0, w).field.ravel() for w in np.eye(len(precision))]).T
    shared = H.noise_sd**2 * Phi @ np.linalg.inv(precision) @ Phi.T
    own = shared.reshape(31, 3, 31, 3)[range(31), :, range(31)]
    own[-1] += H.signal_sd**2 * np.eye(3)
    np.testing.assert_allclose(fitted.covariance(q), own, atol=1e-8 * own.max())
    # To a thousandth.
    np.testing.assert_allclose(H.noise_sd**2 * fitted.influence(q), shared, atol=1e-3 * shared.max())


@pytest.mark.parametrize("order", [0, 1])
def test_few_points_by_solves_and_many_by_the_selected_inverse_agree(spline, order):
    model, _ = spline
    x, b = samples()
    other = model.infer(model.observe(x, b))
    q = np.r_[queries(5), FAR[:1]]
    by_solves = other.covariance(q, order)
    assert "_selected_inverse" not in vars(other)
    many = other.covariance(np.tile(q, (400, 1)), order)
    assert "_selected_inverse" in vars(other)
    np.testing.assert_allclose(by_solves, many[:6], atol=1e-9 * by_solves.max())
    assert np.array_equal(by_solves, other.covariance(q, order))


def test_no_points_have_no_covariance(spline):
    _, fitted = spline
    nothing = np.zeros((0, 3))
    assert fitted.covariance(nothing, 1).shape == (0, 12, 12)
    assert fitted.influence(nothing).shape == (0, 0)
