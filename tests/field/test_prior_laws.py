# SPDX-License-Identifier: BSD-3-Clause
"""Laws that hold for every prior: one posterior whatever the order, the physics promised, derivatives, covariance."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from magmatch.data.survey import Survey
from magmatch.errors import SurveyError
from magmatch.field.build import map_samples
from magmatch.field.config import FieldConfig
from magmatch.field.fit import fit_posterior
from magmatch.field.hyperparameters import Hyperparameters
from magmatch.field.map import FieldMap
from magmatch.field.priors import PRIORS
from magmatch.geometry import random_transform, transform_points

laws = settings(deadline=None, max_examples=6)
H = Hyperparameters(lengthscale=0.6, signal_sd=12e-6, noise_sd=0.5e-6, spacing=0.4, divergence_weight=300.0)
EARTH = np.array([18e-6, 2e-6, -44e-6])
BOX = np.array([2.0, 1.5, 0.8])
CURL_FREE = {"spline", "curl_free", "harmonic"} & PRIORS.keys()
DIVERGENCE_FREE = {"divergence_free", "harmonic"} & PRIORS.keys()


QUERIES = np.random.default_rng(9).uniform(0.1, BOX - 0.1, size=(12, 3))


@pytest.fixture(scope="module")
def samples(room):
    return room()


@pytest.fixture(scope="module", params=sorted(PRIORS))
def name(request):
    return request.param


@pytest.fixture(scope="module")
def model(name, samples):
    return PRIORS[name].build(*samples, H)


@pytest.fixture(scope="module")
def posterior(model, samples):
    return model.infer(model.observe(*samples))


def assert_same_posterior(one, other):
    field, covariance = one.evaluate(QUERIES, 1), one.covariance(QUERIES, 1)
    expected, expected_covariance = other.evaluate(QUERIES, 1), other.covariance(QUERIES, 1)
    np.testing.assert_allclose(field.field, expected.field, rtol=0, atol=1e-8 * np.abs(expected.field).max())
    np.testing.assert_allclose(field.gradient, expected.gradient, rtol=0, atol=1e-8 * np.abs(expected.gradient).max())
    for part in (slice(3), slice(3, 12)):
        block = expected_covariance[:, part, part]
        np.testing.assert_allclose(covariance[:, part, part], block, rtol=0, atol=1e-8 * H.signal_sd**2)


@laws
@given(st.integers(0, 1000), st.lists(st.integers(100, 300), max_size=4))
def test_samples_left_out_in_any_order_and_split_are_as_if_never_seen(samples, model, seed, cuts):
    points, field = samples
    order = np.random.default_rng(seed).permutation(300)
    kept, *left_out = np.split(order, sorted(cuts))
    rest = model.observe(points[order], field[order])
    for rows in left_out:
        rest = rest - model.observe(points[rows], field[rows])
    assert_same_posterior(model.infer(rest), model.infer(model.observe(points[kept], field[kept])))


def test_the_laws_that_are_promised_hold_exactly(name, posterior):
    away = QUERIES + np.random.default_rng(1).normal(size=QUERIES.shape) * 0.3
    for points in (QUERIES, away):
        gradient = posterior.evaluate(points, 1).gradient
        size = np.abs(gradient).max()
        if name in CURL_FREE:
            np.testing.assert_allclose(gradient, gradient.transpose(0, 2, 1), rtol=0, atol=1e-9 * size)
        if name in DIVERGENCE_FREE:
            np.testing.assert_allclose(np.trace(gradient, axis1=1, axis2=2), 0, atol=1e-9 * size)


def test_derivatives_equal_finite_differences(posterior):
    # Splines are differentiated inside of cells; a step this small seldom crosses a cell's side.
    step = 1e-5
    values = posterior.evaluate(QUERIES, 2)
    for axis in range(3):
        d = step * np.eye(3)[axis]
        after, before = posterior.evaluate(QUERIES + d, 1), posterior.evaluate(QUERIES - d, 1)
        slope = (after.field - before.field) / (2 * step)
        bend = (after.gradient - before.gradient) / (2 * step)
        np.testing.assert_allclose(slope, values.gradient[:, :, axis], atol=1e-6 * np.abs(values.gradient).max())
        np.testing.assert_allclose(bend, values.second[..., axis], atol=1e-5 * np.abs(values.second).max())


def test_covariance_is_symmetric_and_positive(posterior):
    covariance = posterior.covariance(QUERIES, 1)
    np.testing.assert_array_equal(covariance, covariance.transpose(0, 2, 1))
    scale = np.sqrt(np.diagonal(covariance, axis1=1, axis2=2))
    correlation = covariance / (scale[:, :, None] * scale[:, None])
    assert np.linalg.eigvalsh(correlation).min() > -1e-6


def test_covariance_of_the_gradient_comes_with_that_of_the_field(posterior):
    q = np.concatenate([QUERIES, QUERIES + 40])
    own, both = posterior.covariance(q), posterior.covariance(q, 1)
    assert both.shape == (24, 12, 12)
    np.testing.assert_allclose(both[:, :3, :3], own, atol=1e-8 * own.max())


def test_draws_spread_no_wider_than_the_covariance_says_and_those_of_a_spline_as_wide(name, posterior):
    q = QUERIES[:5]
    draws = [posterior.evaluate(q, 0, w).field for w in posterior.draw_weights(1500, np.random.default_rng(1))]
    ratio = np.var(draws, axis=0) / np.diagonal(posterior.covariance(q), axis1=1, axis2=2)
    # 1,500 draws give a variance to 3.7 %.
    assert ratio.max() < 1.12
    # Draws of others leave out what lies between the nodes.
    assert ratio.min() > (0.88 if name == "spline" else 0.02)


def test_without_factors_the_mean_is_the_same(name, posterior):
    q, mean = np.concatenate([QUERIES, QUERIES + 40]), posterior.without_factors()
    for order in (0, 1):
        np.testing.assert_array_equal(mean.evaluate(q, order).field, posterior.evaluate(q, order).field)
    np.testing.assert_array_equal(mean.evaluate(q, 1).gradient, posterior.evaluate(q, 1).gradient)
    if name == "spline":
        with pytest.raises(RuntimeError, match="factors of this posterior are not kept"):
            mean.covariance(q)


def test_far_away_the_prior_returns(posterior):
    far = np.array([[30.0, 0.0, 0.0], [1e7, 1e7, 1e7]])
    covariance = posterior.covariance(far, 1)
    near = posterior.covariance(QUERIES, 1)
    assert np.isfinite(covariance).all()
    variance = np.diagonal(covariance, axis1=1, axis2=2)
    assert np.all(variance[:, :3] >= 0.99 * H.signal_sd**2)
    assert np.all(variance[:, 3:].max(axis=1) > 2 * np.diagonal(near, axis1=1, axis2=2)[:, 3:].max())
    assert not posterior.knows(far).any()
    assert np.abs(posterior.evaluate(far, 0).field - EARTH).max() < 30e-6


def test_more_samples_never_make_it_less_certain(model, samples):
    points, field = samples
    few, more = (model.infer(model.observe(points[:n], field[:n])).covariance(QUERIES) for n in (100, 300))
    assert np.linalg.eigvalsh(few - more).min() > -1e-9 * H.signal_sd**2


def mapped(survey, name, domain=None):
    """What `build_map` does once the numbers are known."""
    T_map_model, config = survey.principal_frame(), FieldConfig(prior=name, domain=domain)
    posterior = fit_posterior(survey.transformed(T_map_model.inv()), H, config, T_map_model)
    return FieldMap(survey, posterior, T_map_model, config, T_map_model)


def test_the_map_turns_and_moves_with_its_survey(name, samples):
    T = random_transform(np.random.default_rng(0))
    turned, expected = mapped(Survey(*samples).transformed(T), name), mapped(Survey(*samples), name)
    there = turned.evaluate(transform_points(QUERIES, T), 1)
    here = expected.evaluate(QUERIES, 1).rotated(T)
    np.testing.assert_allclose(there.field, here.field, rtol=0, atol=1e-6 * np.abs(here.field).max())
    np.testing.assert_allclose(there.gradient, here.gradient, rtol=0, atol=1e-6 * np.abs(here.gradient).max())
    spread = np.trace(turned.covariance(transform_points(QUERIES, T)), axis1=1, axis2=2)
    np.testing.assert_allclose(spread, np.trace(expected.covariance(QUERIES), axis1=1, axis2=2), rtol=1e-5)


@pytest.mark.parametrize("box", [None, (0.0, 0.0, 0.0, 1.2, 1.2, 0.5)])
def test_covariances_turn_with_the_map(name, box, samples):
    here = mapped(Survey(*samples), name, box)
    T, q = random_transform(np.random.default_rng(2)), np.concatenate([QUERIES, QUERIES + 40])
    R = T.rotation.as_matrix()
    both = np.zeros((12, 12))
    both[:3, :3], both[3:, 3:] = R, np.kron(R, R)
    for turn, order in ((R, 0), (both, 1)):
        expected = turn @ here.covariance(q, order) @ turn.T
        found = here.transformed(T).covariance(transform_points(q, T), order)
        np.testing.assert_allclose(found, expected, atol=1e-7 * expected.max())


@pytest.mark.parametrize("n", [1, 3])
def test_very_few_samples_are_refused_or_bounded(name, n, room):
    points, field = room(n=n)
    try:
        built = map_samples((Survey(points, field),), FieldConfig(prior=name))
    except SurveyError as error:
        message = str(error)
        assert f"got {n}" in message
    else:
        assert np.abs(built.evaluate(points).field).max() < 3 * np.abs(field).max()


FILLS = {
    "coincident": lambda room, dipoles_at: (np.ones((30, 3)), dipoles_at(np.ones((30, 3)))),
    "coincident, different": lambda room, dipoles_at: (np.ones((30, 3)), room(n=30)[1]),
    "constant": lambda room, dipoles_at: (room(n=30)[0], np.tile(EARTH, (30, 1))),
    "zero": lambda room, dipoles_at: (room(n=30)[0], np.zeros((30, 3))),
    "line": lambda room, dipoles_at: (room(n=30)[0] * [1, 0, 0], dipoles_at(room(n=30)[0] * [1, 0, 0])),
    "four": lambda room, dipoles_at: room(n=4),
}


@pytest.mark.parametrize("fill", FILLS)
def test_singular_surveys_give_bounded_answers(name, fill, room, dipoles_at):
    points, field = FILLS[fill](room, dipoles_at)
    survey = Survey(points, field)
    built = map_samples((survey,), FieldConfig(prior=name))
    at = np.concatenate([points, points + 0.2])
    assert np.isfinite(built.evaluate(at, 2).second).all()
    assert np.abs(built.evaluate(at).field).max() <= 3 * np.abs(field).max() + 1e-9
    assert np.linalg.eigvalsh(built.covariance(at)).min() > -1e-20


ABSURD = {"lengthscale": (1e-6, 1e6), "spacing": (1e5,), "signal_sd": (1e-18, 1e3), "noise_sd": (1e-15, 1e3)}


@pytest.mark.parametrize(("number", "value"), [(number, value) for number in ABSURD for value in ABSURD[number]])
def test_absurd_hyperparameters_give_one_clear_error_or_a_bounded_answer(name, number, value, room):
    points, field = room(n=60)
    h = replace(H, **{number: value})
    try:
        model = PRIORS[name].build(points, field, h)
        posterior = model.infer(model.observe(points, field))
    except (ValueError, SurveyError) as error:
        assert "\n" not in str(error)  # noqa: PT017
        return
    assert np.isfinite(posterior.evaluate(QUERIES, 1).gradient).all()
    assert np.abs(posterior.evaluate(points).field).max() < 10 * np.abs(field).max()
    assert np.isfinite(posterior.covariance(QUERIES)).all()
