# SPDX-License-Identifier: BSD-3-Clause
"""The covariance of residuals along a path: entry by entry, and against the errors it stands for."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.integrate import quad
from scipy.spatial.distance import cdist
from scipy.stats import chi2 as chi2_of
from scipy.stats import multivariate_normal, norm

from hand_made import some_field
from magmatch.data.survey import Survey
from magmatch.estimation.path_noise import (
    PathNoise,
    Stretch,
    _likelihood,
    _stack_alike,
    learn_path_noise,
    likelier_of_kinds,
    most_likely,
    predict_stretches,
)
from magmatch.field.build import build_map
from magmatch.field.config import FieldConfig
from magmatch.field.fit import fit_posterior

NOISE = PathNoise(1.1e-6, 0.8, 0.3e-6, 0.5e-6, 1.4, 0.6, 0.02, 0.06, 4.0, spread=0.4, n_stretches=9)


def some_path(n=5, seed=0):
    rng = np.random.default_rng(seed)
    x = np.cumsum(0.3 * rng.standard_normal((n, 3)), axis=0)
    return (
        x,
        cdist(x, x),
        3e-7 * rng.uniform(0.5, 2, n),
        1e-5 * rng.standard_normal((n, 3, 3)),
        4e-5 * rng.standard_normal((n, 3)),
    )


def test_a_smooth_misfit_is_a_matern_process_and_of_the_same_variance():
    _, d, sd, _, _ = some_path()
    smooth = replace(NOISE, is_smooth=True)
    x = np.sqrt(3) * d / 0.8
    change = 1.1e-6**2 * ((1 + x) * np.exp(-x) - np.exp(-d / 0.8))
    np.testing.assert_allclose(smooth.isotropic(d, sd) - NOISE.isotropic(d, sd), change, atol=1e-24)


@pytest.mark.parametrize("is_smooth", [False, True])
def test_residuals_say_whether_the_misfit_is_smooth(is_smooth):
    true = replace(NOISE, misfit_sd=2e-6, nugget_sd=1e-7, drift_sd=0.01, attitude_sd=2e-3, map_factor=0.3)
    true = replace(true, is_smooth=is_smooth)
    guess = replace(NOISE, spread=0.5, n_stretches=0)
    found = likelier_of_kinds(guess, stretches_of(true, 12, 5, n=16))
    assert found.is_smooth == is_smooth
    assert found.n_stretches == 12


def test_components_are_coupled_by_what_the_walkers_frame_drifts_and_turns():
    """Errors are drawn as they come about: a shift moves the field by its gradient, a turn across itself."""
    _, d, sd, G, b = some_path()
    n, rng = 5, np.random.default_rng(1)
    L = np.linalg.cholesky(np.exp(-d / 4.0))
    shift, turn = (s * np.einsum("ij,kjc->kic", L, rng.standard_normal((40_000, n, 3))) for s in (0.06, 0.02))
    errors = np.einsum("iab,kib->kia", G, shift) + np.cross(b, turn)
    walker = NOISE.full(d, sd, G, b) - np.kron(NOISE.isotropic(d, sd), np.eye(3))
    drawn = errors.reshape(len(errors), -1)
    np.testing.assert_allclose(walker, drawn.T @ drawn / len(errors), atol=0.03 * np.diag(walker).max())
    stack = NOISE.full(np.stack([d, d]), np.stack([sd, sd]), np.stack([G, 2 * G]), np.stack([b, 2 * b]))
    np.testing.assert_allclose(stack[0], NOISE.full(d, sd, G, b), rtol=1e-12)
    np.testing.assert_allclose(stack[1] - stack[0], 3 * walker, rtol=1e-9, atol=1e-24)


@pytest.mark.parametrize("chi2", [25.0, 60.0, 150.0])
def test_the_factor_is_where_the_likelihood_is_largest_and_the_likelihood_its_average(chi2):
    """Against a fine search, and against numerical quadrature over the spread's own density."""
    u = np.linspace(-1.6, 1.6, 20_001)
    log_density = -0.5 * chi2 * np.exp(-u) - 0.5 * 60 * u - 0.5 * (u / 0.4) ** 2
    factor, value = NOISE.factor(chi2, 60)
    # The factors that are tried lie a twentieth of the spread apart.
    assert np.log(factor) == pytest.approx(u[log_density.argmax()], abs=0.011)
    most = log_density.max()
    average, _ = quad(lambda v: np.exp(-0.5 * chi2 * np.exp(-v) - 30 * v - most) * norm.pdf(v, scale=0.4), -4, 4)
    # What lies beyond four deviates is left out.
    assert value == pytest.approx(most + np.log(average), abs=2e-3)


@pytest.mark.parametrize("spread", [0.1, 0.4, 0.7])
@pytest.mark.parametrize("n_free", [3, 18, 90])
def test_where_residuals_are_as_expected_the_normalised_likelihood_ratio_is_one_on_average(spread, n_free):
    """Over chi-square itself, by quadrature: the averaged density is a density, whatever the spread."""
    noise = replace(NOISE, spread=spread)
    # Chi^2 times the largest factor, far into its tail.
    u = np.linspace(-12, np.log(40 * n_free * np.exp(4 * spread) + 2000), 6000)
    ratio = np.array([noise.factor(c, n_free)[1] for c in np.exp(u)]) + np.exp(u) / 2
    density = np.exp(ratio + chi2_of(n_free).logpdf(np.exp(u)) + u)
    assert np.trapezoid(density, u) == pytest.approx(1, abs=1e-3)


def stretches_of(noise, n_stretches, seed, n=12, factors=None):
    rng, found = np.random.default_rng(seed), []
    for k in range(n_stretches):
        x, d, sd, G, b = some_path(n, seed=100 + k)
        L = np.linalg.cholesky(noise.full(d, sd, G, b))
        residual = (L @ rng.standard_normal(3 * n)).reshape(n, 3) * (1.0 if factors is None else factors[k])
        found.append(Stretch(x, residual, sd, G, b))
    return found


def test_what_is_learned_is_the_mode_of_likelihood_and_guess():
    """No parameter can be moved for the better: a dense normal density, and a normal one of each logarithm."""
    stretches = stretches_of(NOISE, 6, 2)
    guess = replace(NOISE, misfit_sd=0.6e-6, nugget_sd=0.5e-6, drift_sd=0.03, spread=0.5, n_stretches=0)
    found = most_likely(guess, stretches)
    names = ["misfit_sd", "misfit_length", "nugget_sd", "constant_sd", "map_factor", "map_length", "attitude_sd",
             "drift_sd", "drift_length"]  # fmt: skip

    def log_posterior(noise):
        total = 0.0
        for s in stretches:
            C = noise.full(cdist(s.positions, s.positions), s.map_sd, s.gradient, s.field)
            scale = 1e12 * C
            total += multivariate_normal(np.zeros(len(C)), scale).logpdf(1e6 * s.residual.ravel())
        for name in names:
            sd = 0.7 if name.endswith("_sd") else 0.35
            total -= 0.5 * (np.log(getattr(noise, name) / getattr(guess, name)) / sd) ** 2
        return total

    best = log_posterior(found)
    assert best > log_posterior(guess) + 1
    for name in names:
        for factor in (0.9, 1.1):
            assert log_posterior(replace(found, **{name: factor * getattr(found, name)})) < best + 1e-3, name
    assert found.n_stretches == 6


@pytest.mark.parametrize("is_smooth", [False, True])
def test_the_likelihoods_slope_is_its_difference_quotient(is_smooth):
    noise, stretches = replace(NOISE, is_smooth=is_smooth), stretches_of(NOISE, 3, 6)
    (stack,) = _stack_alike(stretches)

    def cost(one):
        chi2, half_log_det, _ = _likelihood(one, *stack)
        return (0.5 * chi2 + half_log_det).sum()

    for name, slope in _likelihood(noise, *stack)[2].items():
        up, down = (cost(replace(noise, **{name: np.exp(h) * getattr(noise, name)})) for h in (1e-5, -1e-5))
        assert slope == pytest.approx((up - down) / 2e-5, rel=1e-4, abs=1e-4), name


def test_a_field_that_repeats_exactly_but_for_a_constant_has_a_noise_too():
    """The likelihood grows as the other parameters shrink, until covariances are singular."""
    rng, stretches = np.random.default_rng(0), []
    for _ in range(30):
        x, constant = (
            np.cumsum(0.3 * rng.standard_normal((5, 3)), axis=0),
            np.tile(1e-6 * rng.standard_normal(3), (5, 1)),
        )
        G, b = 1e-9 * rng.standard_normal((5, 3, 3)), 1e-9 * rng.standard_normal((5, 3))
        stretches.append(Stretch(x, constant, np.zeros(5), G, b))
    found = most_likely(replace(NOISE, spread=0.5, n_stretches=0), stretches)
    assert found.constant_sd > 10 * max(found.misfit_sd, found.nugget_sd) > 0
    assert np.isfinite(found.spread)


@pytest.mark.parametrize("scatter", [0.0, 0.6])
def test_how_walks_differ_is_learned_beside_what_chance_makes_of_them(scatter):
    """The scatter of chi^2, less that of chance, against a guess that counts as five stretches."""
    factors = np.exp(scatter / 2 * np.random.default_rng(3).standard_normal(20))
    stretches = stretches_of(NOISE, 20, 4, factors=factors)
    found = most_likely(replace(NOISE, spread=0.5, n_stretches=0), stretches)
    chi2 = []
    for s in stretches:
        C = found.full(cdist(s.positions, s.positions), s.map_sd, s.gradient, s.field)
        chi2.append(s.residual.ravel() @ np.linalg.solve(C, s.residual.ravel()))
    excess = max(np.mean(np.log(np.array(chi2) / 36) ** 2) - 2 / 36, 0.0)
    assert found.spread**2 == pytest.approx((5 * 0.5**2 + 20 * excess) / 25, rel=1e-6)
    assert (excess > 0.1) == (scatter > 0)


def test_left_out_stretches_hold_the_field_where_they_lie_and_what_the_rest_misses_of_it():
    """Of laps beside one another through a known field, each stretch told by the other laps."""
    angle, noise = np.linspace(0, 10 * np.pi, 1500), 3e-7
    x = (1.0 + 0.005 * angle)[:, None] * np.c_[np.cos(angle), np.sin(angle), 0.1 * np.sin(3 * angle)]
    truth, length = some_field(1), 0.5
    survey = Survey(x, truth.evaluate(x).field + noise * np.random.default_rng(0).standard_normal(x.shape))
    field_map = build_map(survey, NUMBERS)
    found, _ = predict_stretches(field_map, length, np.random.default_rng(0))
    T = field_map.T_map_model
    z = []
    for one in found:
        here = truth.evaluate(T.apply(one.positions), 1).rotated(T.inv())
        # Means of curved pieces, of some samples each.
        np.testing.assert_allclose(one.field, here.field, atol=5 * noise)
        assert np.median(np.abs(one.gradient - here.gradient)) < 0.1 * np.abs(here.gradient).max()
        steps = np.linalg.norm(np.diff(one.positions, axis=0), axis=1)
        assert np.median(steps) == pytest.approx(0.25 * length, rel=0.3)
        assert 8 <= len(one.positions) <= 5 / 0.25 + 1
        z.append(one.residual / np.sqrt(noise**2 / 6 + one.map_sd**2)[:, None])
    # Two of five stretches of five lengths of this path of 34 m.
    assert len(found) == pytest.approx(0.4 * 34 / 2.5, abs=1.5)
    assert 0.6 < np.sqrt(np.mean(np.concatenate(z) ** 2)) < 1.4


NUMBERS = FieldConfig(prior="spline", lengthscale=0.6, signal_sd=2e-5, noise_sd=3e-7, spacing=0.25)


def laps(noise=0.0, away=(0.0, 0.0, 0.0)):
    """Three laps that widen, through a known field."""
    angle = np.linspace(0, 6 * np.pi, 700)
    x = (1.0 + 0.01 * angle)[:, None] * np.c_[np.cos(angle), np.sin(angle), 0.1 * np.sin(3 * angle)]
    return Survey(
        x + away, some_field(1).evaluate(x).field + noise * np.random.default_rng(0).standard_normal(x.shape)
    )


def test_a_domain_far_from_the_models_origin_leaves_stretches_as_they_are():
    survey = laps(away=(50.0, 20.0, 0.0))
    box = (*(survey.positions.min(axis=0) - 2.0), *(survey.positions.max(axis=0) + 2.0))
    free, within = (
        predict_stretches(
            build_map(survey, NUMBERS.model_copy(update={"domain": one})), 0.5, np.random.default_rng(0)
        )
        for one in (None, box)
    )
    assert len(free[0]) == len(within[0]) > 0
    for one, other in zip(free[0], within[0], strict=True):
        np.testing.assert_array_equal(one.residual, other.residual)


def test_stretches_that_the_posterior_knows_are_the_same_however_it_is_inflated():
    """Inflation makes up for errors that no spread predicts; it says nothing of how far other passes are."""
    field_map = build_map(laps(noise=3e-7), NUMBERS)
    samples = field_map.survey.transformed(field_map.T_map_model.inv())
    found = []
    for inflation in (1.0, 100.0):
        h = replace(field_map.hyperparameters, inflation=inflation)
        inflated = replace(field_map, posterior=fit_posterior(samples, h, field_map.config))
        found.append(predict_stretches(inflated, 0.5, np.random.default_rng(0)))
    (_, little), (by_spread, much) = found
    assert len(little) == len(much) > 0
    for one, other in zip(little, much, strict=True):
        np.testing.assert_array_equal(one.positions, other.positions)
        np.testing.assert_allclose(other.map_sd, 100 * one.map_sd, rtol=1e-9)
    assert sum(len(one.positions) for one in by_spread) < sum(len(one.positions) for one in much)


@pytest.mark.parametrize("stated", [0.0, 0.3])
def test_where_drift_cannot_be_learned_a_pose_is_not_stated_better_than_where_it_can(stated):
    """A line passed once holds out nothing; CEA's positions drift by 0.05 field lengths, a museum's by 0.18."""
    x = np.c_[np.linspace(0, 6, 200), np.zeros((200, 2))]
    survey = Survey(x, some_field(1).evaluate(x).field, pose_sd=stated)
    _, live = learn_path_noise(build_map(survey, NUMBERS), 2.0, np.random.default_rng(0))
    assert not live.is_learned
    assert live.drift_sd == pytest.approx(max(stated, 0.16))
