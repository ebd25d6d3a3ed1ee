# SPDX-License-Identifier: BSD-3-Clause
"""Tiles: laws of the partition, blended derivatives, agreement with one large fit, information that adds."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from magmatch.errors import ConfigurationError
from magmatch.field.hyperparameters import Hyperparameters
from magmatch.field.priors import PRIORS
from magmatch.field.spline.spline_model import SplineModel
from magmatch.field.tiles.region_model import TiledModel
from magmatch.field.tiles.tile_fit import TileCache
from magmatch.field.tiles.tiled_draws import normals
from magmatch.field.tiles.tiles import TileKeys, Tiling
from magmatch.threads import one_blas_thread

few = settings(deadline=None, max_examples=20)
H = Hyperparameters(0.6, 4e-6, 5e-7, 0.2, 300.0, inflation=1.3)
SMALL = Tiling(H.spacing, margin=5, reach=2, core=8, blend=2)


def walk(seed=0):
    """Crossing lines over 4 x 3 m, a field of waves, and 0.3 uT of noise."""
    rng = np.random.default_rng(seed)
    s = np.arange(-2, 2, 0.06)
    along = [np.c_[s, np.full(len(s), y), 0.03 * rng.normal(size=len(s))] for y in np.arange(-1.5, 1.6, 0.5)]
    across = [np.c_[np.full(50, x), np.linspace(-1.5, 1.5, 50), 0.03 * rng.normal(size=50)] for x in (-1.5, 0, 1.5)]
    x = np.concatenate([*along, *across])
    return x, waves(x) + 3e-7 * rng.normal(size=x.shape)


def waves(x):
    """Gradient of a harmonic potential, T."""
    field = np.tile([2e-5, 0.0, -4e-5], (len(x), 1))
    for k, (a, b) in enumerate([(1.5, 0.7), (0.4, 2.0), (-1.1, 1.2)]):
        q, phase = np.hypot(a, b), a * x[:, 0] + b * x[:, 1] + k
        rise = 4e-6 * np.exp(q * x[:, 2])
        field += rise[:, None] * np.stack([-a * np.sin(phase), -b * np.sin(phase), q * np.cos(phase)], axis=1) / q
    return field


@pytest.fixture(scope="module")
def fitted():
    x, b = walk()
    with one_blas_thread():
        model = TiledModel.over(x, H, SMALL)
        return model, model.infer(model.observe(x, b)), x, b


@pytest.fixture(scope="module")
def whole():
    x, b = walk()
    model = SplineModel.over(x, H)
    return model.infer(model.observe(x, b))


def inside(n=300, seed=1):
    """Points that the survey surrounds: all their cells are active."""
    return np.random.default_rng(seed).uniform([-1.9, -1.4, -0.1], [1.9, 1.4, 0.1], (n, 3))


@few
@given(seed=st.integers(0, 10**6), core=st.sampled_from([4, 8, 24]), blend=st.integers(1, 2))
def test_shares_of_all_tiles_sum_to_one_and_their_slopes_to_zero(seed, core, blend):
    tiling = Tiling(0.3, 4, 2, core, blend)
    x = np.random.default_rng(seed).uniform(-20, 20, 50)
    numbers = range(int(-20 / 0.3 / core) - 2, int(20 / 0.3 / core) + 3)
    total = np.sum([tiling.axis_weights(x, k) for k in numbers], axis=0)
    np.testing.assert_allclose(total[0], 1.0, atol=1e-12)
    np.testing.assert_allclose(total[1:], 0.0, atol=1e-9)


@few
@given(seed=st.integers(0, 10**6))
def test_every_tile_with_a_say_exists_and_sees_every_sample_that_reaches_its_cells(seed):
    rng = np.random.default_rng(seed)
    x = rng.uniform(-4, 4, (30, 3)) * [1, 1, 0.2]
    tiles = SMALL.occupied(x)
    assert tiles == sorted(tiles)
    near = x + H.spacing * rng.integers(-2, 3, x.shape)
    share = np.zeros(len(near))
    for number, rows in SMALL.blended(near, TileKeys(tiles)):
        along = [SMALL.axis_weights(near[rows, a], tiles[number][a])[0] for a in range(3)]
        share[rows] += along[0] * along[1] * along[2]
    np.testing.assert_allclose(share, 1.0, atol=1e-12)
    cells = np.floor(x / H.spacing + 0.5)
    for index, rows in zip(tiles, SMALL.assign(x, tiles), strict=True):
        low, high = SMALL.box(index)
        reaches = np.all((cells >= low - SMALL.reach) & (cells < high + SMALL.reach), axis=1)
        assert np.array_equal(rows, np.flatnonzero(reaches))


def test_tiles_agree_with_one_fit_to_a_third_of_a_standard_deviation(fitted, whole):
    q = inside()
    sd = np.sqrt(np.trace(whole.covariance(q), axis1=1, axis2=2))
    difference = np.linalg.norm(fitted[1].evaluate(q).field - whole.evaluate(q).field, axis=1) / sd
    assert np.sqrt((difference**2).mean()) < 0.33
    wider = np.trace(fitted[1].covariance(q), axis1=1, axis2=2) / sd**2
    assert wider.min() > 0.99
    assert np.median(wider) < 1.1


def test_blended_derivatives_are_those_of_the_blended_field(fitted):
    posterior, q, e = fitted[1], inside(), 1e-5
    # Second derivatives of the field jump between cells.
    q = q[np.abs(q / H.spacing - np.floor(q / H.spacing) - 0.5).min(axis=1) > 2 * e / H.spacing]
    values = posterior.evaluate(q, 2)
    for axis in range(3):
        step = e * np.eye(3)[axis]
        ahead, behind = posterior.evaluate(q + step, 1), posterior.evaluate(q - step, 1)
        slope, bend = (ahead.field - behind.field) / (2 * e), (ahead.gradient - behind.gradient) / (2 * e)
        np.testing.assert_allclose(slope, values.gradient[:, :, axis], atol=1e-5 * np.abs(values.gradient).max())
        np.testing.assert_allclose(bend, values.second[..., axis], atol=1e-5 * np.abs(values.second).max())


def test_curl_vanishes_where_one_tile_answers_and_is_bounded_where_two_blend(fitted):
    posterior, q = fitted[1], inside(600)
    gradient = posterior.evaluate(q, 1).gradient
    curl = np.abs(gradient - gradient.transpose(0, 2, 1)).max(axis=(1, 2))
    n_tiles, fields = np.zeros(len(q)), []
    for number, rows in SMALL.blended(q, TileKeys(posterior.tiles)):
        n_tiles[rows] += 1
        field = np.full((len(q), 3), np.nan)
        field[rows] = posterior.tile(number).evaluate(q[rows]).field
        fields.append(field)
    assert curl[n_tiles == 1].max() < 1e-12 * np.abs(gradient).max()
    differences = np.nanmax(fields, axis=0) - np.nanmin(fields, axis=0)
    steepest = 1.875 / (2 * SMALL.blend * H.spacing)
    # Each axis' slopes sum to zero, so its part of the curl is at most the slope times the fields' spread.
    assert np.all(curl <= 2 * steepest * differences.max(axis=1) + 1e-15)


@pytest.mark.slow
def test_draws_have_the_posterior_covariance_and_agree_between_tiles(fitted):
    posterior, q = fitted[1], inside(12)
    draws = np.array(
        [posterior.evaluate(q, 0, w).field for w in posterior.draw_weights(150, np.random.default_rng(0))]
    )
    covariance = posterior.covariance(q)
    ratio = draws.var(axis=0) / np.diagonal(covariance, axis1=1, axis2=2)
    # 150 draws: 12 % each; blended draws lie a little below the bound.
    assert ratio.mean() == pytest.approx(0.97, abs=0.1)
    error = draws.mean(axis=0) - posterior.evaluate(q).field
    assert np.abs(error / np.sqrt(np.diagonal(covariance, axis1=1, axis2=2))).max() < 4 / np.sqrt(150)


def test_noise_by_name_is_white():
    numbers = normals(3, np.arange(4000, dtype=np.uint64), 8)
    assert abs(numbers.mean()) < 0.02
    np.testing.assert_allclose(np.cov(numbers.T), np.eye(8), atol=0.08)


def test_gradient_covariance_is_a_covariance_and_at_least_that_of_the_tiles(fitted, whole):
    q = inside(60)
    blended, single = fitted[1].covariance(q, 1), whole.covariance(q, 1)
    assert np.linalg.eigvalsh(blended).min() > -1e-9 * np.abs(blended).max()
    np.testing.assert_allclose(blended[:, :3, :3], fitted[1].covariance(q), rtol=1e-9)
    assert np.all(np.trace(blended, axis1=1, axis2=2) > 0.99 * np.trace(single, axis1=1, axis2=2))


def test_influence_inside_one_tile_is_that_of_the_tile(fitted):
    posterior, alone = fitted[1], np.array([[0.01, 0.02, 0.0], [0.05, -0.03, 0.01]])
    expected = posterior.tile(posterior.tiles.index((0, 0, 0))).influence(alone)
    np.testing.assert_allclose(posterior.influence(alone), expected, atol=1e-9 * expected.max())


def test_far_away_and_nowhere_the_prior_answers(fitted):
    far = np.array([[1e9, 0, 0], [np.nan, 0, 0], [0, 0, 50.0]])
    posterior = fitted[1]
    np.testing.assert_allclose(posterior.evaluate(far).field, np.tile(posterior.constant, (3, 1)))
    assert not posterior.knows(far).any()
    sd = np.sqrt(np.diagonal(posterior.covariance(far, 1), axis1=1, axis2=2))
    assert np.all(sd[:, :3] >= H.signal_sd)


def test_large_regions_are_tiled_and_small_ones_not():
    rng = np.random.default_rng(0)
    small = rng.uniform(0, [4, 4, 0.1], (200, 3))
    large = rng.uniform(0, [5e4, 5e4, 10], (60, 3))
    assert isinstance(PRIORS["spline"].build(small, small, H), SplineModel)
    model = PRIORS["spline"].build(large, large, H)
    assert isinstance(model, TiledModel)
    posterior = model.infer(model.observe(large, np.tile([2e-5, 0, 4e-5], (60, 1))))
    np.testing.assert_allclose(posterior.evaluate(large).field, np.tile([2e-5, 0, 4e-5], (60, 1)), atol=1e-6)


def test_region_of_countless_tiles_is_refused_in_one_line(monkeypatch):
    x = np.random.default_rng(0).uniform(0, 1e4, (50, 3))
    with pytest.raises(ConfigurationError, match="too large for a spacing of 1e-06 m; widen"):
        TiledModel.over(x, replace(H, spacing=1e-6))
    monkeypatch.setattr("magmatch.field.tiles.tiles.MOST_TILES", 10)
    with pytest.raises(ConfigurationError, match="at most 10; widen"):
        TiledModel.over(x, H)


# The same bits are promised under one BLAS thread, as every task of a fit runs.
@one_blas_thread()
def test_factors_that_stay_and_factors_made_again_give_the_same_bits(fitted, monkeypatch):
    model, posterior, x, b = fitted
    few_bytes = 4.5 * max(posterior.factored(k).factors.full.n_bytes for k in range(len(model.tiles)))
    monkeypatch.setattr("magmatch.field.tiles.region_model.FACTORED_BYTES", few_bytes)
    elsewhere = model.fit(x, b, {}, lambda fit, tasks: [fit(task) for task in tasks])
    frugal, q = model.infer(model.observe(x, b)), inside(15)
    covariance, influence = posterior.covariance(q), posterior.influence(q)
    for other in (elsewhere, frugal):
        assert np.array_equal(other.covariance(q), covariance)
        assert np.array_equal(other.influence(q), influence)
        draws = [p.draw_weights(2, np.random.default_rng(3)) for p in (posterior, other)]
        assert np.array_equal(*(p.evaluate(q, 0, d[1]).field for p, d in zip((posterior, other), draws, strict=True)))


def test_no_more_factors_stay_than_there_is_room_for():
    model = TiledModel.over(walk()[0], H, SMALL)
    posterior = model.infer(model.observe(*walk()))
    tile = posterior.factored(0)
    one = 3 * tile.factors.light.n_bytes
    assert tile.factors.full.n_bytes == 2 * tile.factors.light.n_bytes
    assert tile.factors.n_bytes == one
    kept, made = TileCache(5 * one), []
    for k in range(4):
        kept.offer(k, posterior.factored(0))
    for k in (0, 1, 2, 3, 4, 2, 3, 4, 4, 0, 1):
        kept.find(k, lambda k=k: made.append(k) or posterior.factored(0))
    # Two of those offered stay, and beside them the last that were asked for.
    assert made[:3] == [2, 3, 4]
    assert not {0, 1} & set(made)


def test_a_factor_in_single_precision_gives_the_same_mean_and_nearly_the_same_spread(fitted):
    posterior, q, n_compared = fitted[1], inside(400), 0
    for k in range(0, len(posterior.tiles), 5):
        task = posterior.tasks.task(k)
        model = task.model()
        exact, light = model.infer(task.observe(model)), posterior.factored(k)
        assert light.factors.light.precision == np.float32
        assert np.abs(light.weights - exact.weights).max() < 1e-9 * np.abs(exact.weights).max()
        near = q[exact.knows(q)]
        if len(near) == 0:
            continue
        n_compared += 1
        np.testing.assert_allclose(light.covariance(near), exact.covariance(near), rtol=1e-6)
        influence = exact.influence(near[:40])
        np.testing.assert_allclose(light.influence(near[:40]), influence, atol=3e-3 * influence.max())
    assert n_compared > 3


def test_where_single_precision_does_not_do_a_factor_is_double():
    x, b = walk()
    model = SplineModel.over(x[:400], replace(H, noise_sd=1e-12))
    light, exact = (f(model.observe(x[:400], b[:400])) for f in (model.infer_in_single_precision, model.infer))
    assert light.factors.light.precision == np.float64
    assert np.array_equal(light.weights, exact.weights)
