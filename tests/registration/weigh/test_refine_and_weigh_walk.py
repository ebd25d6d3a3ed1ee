# SPDX-License-Identifier: BSD-3-Clause
"""What speaks for a walk's pose, term by term, against dense normal densities."""

from dataclasses import replace
from unittest.mock import Mock

import numpy as np
import pytest
from scipy.spatial.distance import cdist
from scipy.spatial.transform import RigidTransform
from scipy.special import logsumexp
from scipy.stats import multivariate_normal

from hand_made import prepared_map, seen_from, some_field, turn_about
from magmatch.estimation import model_prior
from magmatch.estimation.model_prior import TURNS
from magmatch.estimation.path_noise import PathNoise
from magmatch.estimation.pose_prior import PosePrior
from magmatch.estimation.walk import Walk
from magmatch.estimation.walk_null_model import LENGTHSCALES, STRENGTHS, UnrelatedWalk
from magmatch.geometry import random_transform
from magmatch.registration.weigh import refine_and_weigh_walk
from magmatch.registration.weigh.bending import bending_of
from magmatch.registration.weigh.refine_and_weigh_walk import weigh_walk

LENGTH, SD = 0.8, 0.1e-6
FIELD = some_field(3, slope=10e-6, bend=6e-6)
NOISE = PathNoise(0.4e-6, 0.8, 0.2e-6, 0.2e-6, 1.0, 0.8, 0.005, 0.01, 3.0, spread=0.4, n_stretches=9)
PRIOR = PosePrior(20.0)
HERE = RigidTransform.identity()


def some_path(n=24):
    t = np.linspace(0, 1, n)
    return np.stack([2.2 * t - 1.1, 0.7 * np.sin(4 * t), 0.3 * np.cos(5 * t)], axis=1)


@pytest.fixture(scope="module")
def base():
    x = some_path(200)
    return prepared_map(FIELD, x, sd=SD, noise_sd=0.2e-6, spacing=0.05, length=LENGTH)


@pytest.fixture(scope="module")
def walk():
    """With errors as its noise draws them."""
    x = some_path()
    values = FIELD.evaluate(x, 1)
    C = NOISE.full(cdist(x, x), np.full(len(x), SD), values.gradient, values.field)
    error = np.linalg.cholesky(C) @ np.random.default_rng(0).standard_normal(3 * len(x))
    return Walk(HERE, x, values.field + error.reshape(-1, 3))


def weighed(base, walk, T=HERE, noise=NOISE, prior=PRIOR):
    return weigh_walk(base, walk, [T], noise, prior)[0]


def weighed_free(base, walk):
    """What is weighed if path that is left unexplained costs nothing."""
    with pytest.MonkeyPatch.context() as nothing_is_paid:
        nothing_is_paid.setattr(model_prior, "UNEXPLAINED", 0.0)
        nothing_is_paid.setattr(refine_and_weigh_walk, "UNEXPLAINED", 0.0)
        return weighed(base, walk)


def outside(walk, n):
    """The walk with its last bins far from the map; its field there is that of the map's end."""
    x = walk.positions.copy()
    x[-n:] += np.array([0.0, 0.0, 5.0]) + np.linspace(0, 1, n)[:, None] * [0.5, 0, 0]
    return replace(walk, positions=x)


def test_evidence_is_that_of_dense_normal_densities_and_laplaces_approximation(base, walk):
    found = weighed(base, walk)
    T, x, n = found.T_base_target, walk.positions, len(walk)
    seen = FIELD.evaluate(T.apply(x), 1).rotated(T.inv())
    d = cdist(x, x)
    C = NOISE.full(d, np.full(n, SD), seen.gradient, seen.field)
    r = (walk.field - seen.field).ravel()
    chi2 = r @ np.linalg.solve(C, r)
    factor, log_likelihood = NOISE.factor(chi2, 3 * n - 6)
    null = UnrelatedWalk(walk, NOISE, LENGTH).log_likelihood(np.ones(n, dtype=bool))
    price = 0.5 * np.linalg.slogdet(2 * np.pi * found.covariance / factor)[1] - np.log(20.0 * 8 * np.pi**2)
    expected = log_likelihood - 0.5 * np.linalg.slogdet(C)[1] - null + price
    # The last steps see the map's gradient through its raster's cells no more; its field they see exactly.
    assert found.log_evidence == pytest.approx(expected, abs=0.3)
    assert found.misfit == pytest.approx(np.sqrt(chi2 / (3 * n - 6)), rel=0.02)
    assert found.overlap == 1.0
    assert factor == pytest.approx(1.0, abs=0.5)


def test_the_estimate_is_that_of_generalised_least_squares_and_its_covariance_too(base, walk):
    """Gauss-Newton by numerical derivatives, with the data's own factor and the search's own spread."""
    found = weighed(base, walk)
    x, n, c = walk.positions, len(walk), found.center

    def residual(xi):
        T = found.T_base_target * turn_about(c, xi)
        return (walk.field - FIELD.evaluate(T.apply(x)).field @ T.rotation.as_matrix()).ravel()

    steps = 1e-5 * np.eye(6)
    J = np.stack([(residual(e) - residual(-e)) / 2e-5 for e in steps], axis=1)
    T = found.T_base_target
    seen = FIELD.evaluate(T.apply(x), 1).rotated(T.inv())
    C = NOISE.full(cdist(x, x), np.full(n, SD), seen.gradient, seen.field)
    free = np.diag(np.repeat([0.5, 1.5 * LENGTH], 3) ** -2.0)
    A = J.T @ np.linalg.solve(C, J) + free
    r = residual(np.zeros(6))
    xi = -np.linalg.solve(A, J.T @ np.linalg.solve(C, r))
    sd = np.sqrt(np.diag(np.linalg.inv(A)))
    assert np.abs(xi / sd).max() < 0.1
    factor, _ = NOISE.factor(r @ np.linalg.solve(C, r), 3 * n - 6)
    np.testing.assert_allclose(found.covariance, factor * np.linalg.inv(A), atol=0.03 * np.outer(sd, sd).max())
    np.testing.assert_allclose(np.sqrt(np.diag(found.covariance)), np.sqrt(factor) * sd, rtol=0.03)
    assert np.abs(np.concatenate([(T.apply(c) - c) / sd[3:], T.rotation.as_rotvec() / sd[:3]])).max() < 4


def test_path_outside_the_map_costs_its_length_and_nothing_else_is_known_of_it(base, walk):
    n, walk = 6, outside(walk, 6)
    free, priced = weighed_free(base, walk), weighed(base, walk)
    assert free.is_covered.sum() == len(walk) - n
    assert free.overlap == pytest.approx(1 - n / len(walk))
    assert free.log_evidence - priced.log_evidence == pytest.approx(3.0 * n * walk.bin_length / LENGTH, rel=1e-9)


def test_bins_outside_the_map_change_neither_pose_nor_residual(base, walk):
    rng = np.random.default_rng(1)
    far = outside(walk, 6)
    field = far.field.copy()
    field[-6:] += 3e-6 * rng.standard_normal((6, 3))
    one, other = (weighed(base, w) for w in (far, replace(far, field=field)))
    np.testing.assert_allclose(one.T_base_target.as_matrix(), other.T_base_target.as_matrix(), atol=1e-6)
    assert one.misfit == pytest.approx(other.misfit, rel=1e-3)
    np.testing.assert_allclose(one.covariance, other.covariance, rtol=0.05, atol=1e-9)


def test_evidence_does_not_change_with_the_frames(base, walk):
    rng = np.random.default_rng(2)
    A, B = random_transform(rng), random_transform(rng)
    moved = replace(walk, positions=B.apply(walk.positions), field=B.rotation.apply(walk.field))
    here, there = weighed(base, walk), weighed(seen_from(base, A, spacing=0.05, sd=SD), moved, A * B.inv())
    assert there.log_evidence == pytest.approx(here.log_evidence, abs=0.01)
    back = A.inv() * there.T_base_target * B
    np.testing.assert_allclose(back.as_matrix(), here.T_base_target.as_matrix(), atol=1e-5)
    Q = np.kron(np.eye(2), B.rotation.as_matrix())
    np.testing.assert_allclose(there.covariance, Q @ here.covariance @ Q.T, atol=1e-3 * np.abs(here.covariance).max())


def test_evidence_does_not_change_with_the_unit_of_the_field(base, walk):
    unit = 100.0
    field = replace(FIELD, constant=unit * FIELD.constant, linear=unit * FIELD.linear, second=unit * FIELD.second)
    names = ("misfit_sd", "nugget_sd", "constant_sd")
    noise = replace(NOISE, **{name: unit * getattr(NOISE, name) for name in names})
    there = prepared_map(
        field, base.samples, sd=unit * SD, noise_sd=unit * base.noise_sd, spacing=0.05, length=LENGTH
    )
    found = weighed(there, replace(walk, field=unit * walk.field), noise=noise)
    here = weighed(base, walk)
    for name in ("log_evidence", "attainable"):
        # The field's unit is that of the null's density too: 100^3 for each bin cancels.
        assert getattr(found, name) == pytest.approx(getattr(here, name), abs=1e-4)
    np.testing.assert_allclose(found.T_base_target.as_matrix(), here.T_base_target.as_matrix(), atol=1e-8)
    np.testing.assert_allclose(found.covariance, here.covariance, rtol=1e-4, atol=1e-12)


def test_no_walk_has_more_evidence_than_is_attainable(base, walk):
    exact = FIELD.evaluate(walk.positions).field
    calm = weighed(base, replace(walk, field=exact + 0.2 * (walk.field - exact)))
    assert calm.log_evidence <= calm.attainable


@pytest.mark.parametrize("size", [0.3, 2.0])
def test_evidence_is_averaged_over_the_covariances_factor(base, walk, size):
    """Weighed at each factor by itself, however large the residuals are, to what the last steps leave."""
    field = FIELD.evaluate(walk.positions).field
    walk, nothing = replace(walk, field=field + size * (walk.field - field)), Mock(log_likelihood=lambda _: 0.0)

    def evidence(noise):
        return weigh_walk(base, walk, [HERE], noise, PRIOR, null=nothing)[0].log_evidence

    log_factors, log_weights = (x[::5] for x in NOISE.log_factors())
    at_each = [evidence(noise_times(NOISE, np.exp(one))) for one in log_factors]
    averaged = np.logaddexp.reduce(at_each + log_weights) - np.logaddexp.reduce(log_weights)
    assert evidence(NOISE) == pytest.approx(averaged, abs=0.5)


def noise_times(noise, factor):
    """Noise whose covariance is larger by a factor, alike in all walks."""
    sds = ("misfit_sd", "nugget_sd", "constant_sd", "map_factor", "attitude_sd", "drift_sd")
    return replace(noise, **{name: getattr(noise, name) * np.sqrt(factor) for name in sds}, spread=1e-9)


def test_more_noise_than_expected_widens_the_covariance_and_less_narrows_it_only_where_it_was_learned(base, walk):
    exact = FIELD.evaluate(walk.positions).field
    calm = replace(walk, field=exact + 0.2 * (walk.field - exact))
    wild = replace(walk, field=exact + 2.0 * (walk.field - exact))
    guess = replace(NOISE, n_stretches=0)
    spread = {
        (name, noise.is_learned): np.trace(weighed(base, w, noise=noise).covariance[3:, 3:])
        for name, w in (("calm", calm), ("as expected", walk), ("wild", wild))
        for noise in (NOISE, guess)
    }
    assert spread["calm", True] < 0.7 * spread["as expected", True] < 0.7 * spread["wild", True]
    assert spread["calm", False] > 1.4 * spread["calm", True]
    assert spread["wild", False] == pytest.approx(spread["wild", True])


def test_a_vertical_that_is_known_is_known_as_well_where_residuals_are_large(base, walk):
    up = np.array([0.0, 0.0, 1.0])
    prior = PosePrior(20.0, up_base=up, up_target=up, gravity_sd=1e-4)
    louder = replace(walk, field=walk.field + 3 * (walk.field - FIELD.evaluate(walk.positions, 0).field))
    sd = [np.sqrt(np.diag(weighed(base, w, prior=prior).covariance)) for w in (walk, louder)]
    assert sd[1][2] > 1.3 * sd[0][2]
    np.testing.assert_allclose([s[:2] for s in sd], 1e-4, rtol=0.01)


def test_a_piece_that_something_disturbed_is_weighed_down_at_a_price(base, walk, monkeypatch):
    field = walk.field.copy()
    field[8:11] += [4e-6, -3e-6, 3e-6]
    disturbed = replace(walk, field=field)
    strained, undisturbed = weighed(base, disturbed), weighed(base, walk)
    with monkeypatch.context() as nothing_may_be_disturbed:
        nothing_may_be_disturbed.setattr(refine_and_weigh_walk, "OUTLIER_SHARE", 0.0)
        kept, plain = weighed(base, disturbed), weighed(base, walk)
    assert strained.log_evidence > kept.log_evidence + 10
    assert strained.misfit < 0.7 * kept.misfit
    free = weighed_free(base, disturbed)
    n_strained = (free.log_evidence - strained.log_evidence) / (3.0 * disturbed.bin_length / LENGTH)
    assert n_strained == pytest.approx(round(n_strained), abs=1e-6)
    assert 3 <= round(n_strained) <= 0.3 * len(walk) + 0.5
    assert undisturbed.log_evidence == pytest.approx(plain.log_evidence)


def test_a_prior_holds_a_walk_and_pays_for_its_search(base, walk):
    found = weighed(base, walk)
    assert weighed(base, walk, prior=PosePrior(2.0)).log_evidence - found.log_evidence == pytest.approx(np.log(10))
    tight = PosePrior(20.0, found.T_base_target * turn_about(found.center, np.full(6, 0.01)), 1e-10 * np.eye(6))
    held = weighed(base, walk, prior=tight)
    step = held.T_base_target.inv() * tight.T_base_target
    assert np.abs(step.apply(found.center) - found.center).max() < 1e-4


@pytest.mark.parametrize("around", [None, (np.array([18e-6, 3e-6, -45e-6]), 1e-11)])
def test_an_unrelated_walk_is_a_smooth_field_averaged_over_its_numbers(walk, around):
    d = cdist(walk.positions, walk.positions)
    null = UnrelatedWalk(walk, NOISE, LENGTH, around)
    spread2 = walk.field.var(axis=0).mean() + NOISE.nugget_sd**2
    mean, constant = around or (np.zeros(3), (walk.field**2).mean())
    square = (walk.field**2).mean()
    errors = NOISE.misfit_sd**2 * np.exp(-d / NOISE.misfit_length) + NOISE.constant_sd**2
    errors += 2 * square * NOISE.attitude_sd**2 * np.exp(-d / NOISE.drift_length)
    errors += NOISE.nugget_sd**2 * np.eye(len(d))
    # Walks differ by a factor on the whole, whose logarithm is normal.
    deviates = np.linspace(-4, 4, 161)
    log_prior = -0.5 * deviates**2
    tried = []
    for factor in LENGTHSCALES:
        for strength in STRENGTHS:
            K = strength**2 * spread2 / (1 + d**2 / (2 * (factor * LENGTH) ** 2)) + constant + errors
            found = [
                multivariate_normal(np.zeros(len(d)), 1e12 * np.exp(NOISE.spread * z) * K)
                .logpdf(1e6 * (walk.field - mean).T)
                .sum()
                for z in deviates
            ]
            tried.append(logsumexp(found + log_prior) - logsumexp(log_prior))
    # In microtesla, and with the factor of 2 pi.
    constant = 3 * len(d) * (0.5 * np.log(2 * np.pi) + np.log(1e6))
    average = logsumexp(tried) - np.log(len(tried))
    assert null.log_likelihood(np.ones(len(d), dtype=bool)) == pytest.approx(average + constant, rel=1e-9)


def test_a_rough_walk_is_no_evidence_for_a_place_where_nothing_varies():
    """What a pose in a calm place explains by the walk's errors alone, unrelated walks explain as well."""
    t, earth = np.linspace(0, 12, 100)[:, None], np.array([18e-6, 3e-6, -45e-6])
    x = t * [1.0, 0, 0]
    d = cdist(x, x)
    turning = 2 * NOISE.attitude_sd**2 * (earth @ earth) / 3 * np.exp(-d / NOISE.drift_length)
    C = NOISE.isotropic(d, np.zeros(len(x))) + turning
    L = np.linalg.cholesky(C)
    for seed, times in enumerate((1.0, 1.0, 2.0, 3.0)):
        z = times * np.random.default_rng(seed).standard_normal((len(x), 3))
        walk = Walk(HERE, x, earth + L @ z)
        posed = NOISE.factor((z**2).sum(), 3 * len(x))[1] - 3 * np.log(np.diag(L)).sum()
        null = UnrelatedWalk(walk, NOISE, LENGTH).log_likelihood(np.ones(len(x), dtype=bool))
        # That both fields agree in the mean is evidence, of some nats a component.
        assert posed - null < 25


def test_a_walk_that_turns_by_itself_is_no_evidence_for_a_place_where_nothing_varies():
    """What its orientations do to the field, they do in any place."""
    t, earth = np.linspace(0, 12, 60)[:, None], np.array([18e-6, 3e-6, -45e-6])
    x, rate = t * [1.0, 0, 0], 0.1
    turned = rate**2 * bending_of(x, TURNS[1]).turned(np.tile(earth, (60, 1)))
    C = turned.reshape(180, 180) + NOISE.nugget_sd**2 * np.eye(180)
    L, noise = np.linalg.cholesky(C), replace(NOISE, misfit_sd=0.0, constant_sd=0.0, attitude_sd=0.0)
    without, with_turns = [], []
    for seed in range(5):
        z = np.random.default_rng(seed).standard_normal(180)
        walk = Walk(HERE, x, earth + (L @ z).reshape(60, 3))
        null = UnrelatedWalk(walk, noise, LENGTH)
        posed = noise.factor(z @ z, 180)[1] - np.log(np.diag(L)).sum()
        everywhere = np.ones(60, dtype=bool)
        without.append(posed - null.log_likelihood(everywhere))
        with_turns.append(posed - replace(null, turned=turned[None]).log_likelihood(everywhere))
    assert min(without) > 40
    # That both fields agree in the mean is evidence.
    assert max(with_turns) < 25


@pytest.mark.parametrize("around", [None, (np.array([18e-6, 3e-6, -45e-6]), 1e-11)])
def test_bins_that_a_pose_leaves_out_say_nothing_of_the_others(walk, around):
    """A calm part that lies beside a rough one is weighed as a walk that is calm."""
    calm = np.arange(len(walk)) < 12
    field = walk.field + 2e-5 * np.random.default_rng(0).standard_normal(walk.field.shape) * ~calm[:, None]
    part = walk.part(np.flatnonzero(calm))
    alone = UnrelatedWalk(part, NOISE, LENGTH, around).log_likelihood(np.ones(12, dtype=bool))
    found = UnrelatedWalk(replace(walk, field=field), NOISE, LENGTH, around).log_likelihood(calm)
    assert found == pytest.approx(alone, rel=1e-12)
