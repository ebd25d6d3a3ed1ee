# SPDX-License-Identifier: BSD-3-Clause
"""A few unknowns beside a large problem: dense least squares, and errors that are alike along the path."""

import numpy as np
import pytest
import scipy.stats

from magmatch.preparation.least_squares import ParameterBlock, System

N, NOISE = 800, 0.5e-6
RNG = np.random.default_rng(0)
ONE = RNG.standard_normal((3, N, 3))
TWO = 1e-5 * RNG.standard_normal((2, N, 3))
WEIGHTS = RNG.uniform(0.5, 1.5, N)
TRUTH = {"one": np.array([4e-6, -2e-6, 3e-6]), "two": np.array([0.05, -0.03])}
BLOCKS = {"one": ParameterBlock(ONE, 10e-6), "two": ParameterBlock(TWO, 0.1)}


def project(columns):
    """Weighted; a constant field is what the map explains."""
    left = columns * WEIGHTS[:, None]
    return left, columns - left.sum(axis=1, keepdims=True) / WEIGHTS.sum()


def field(noise=NOISE, seed=1, truth=TRUTH, errors=None):
    """What was read: minus what the unknowns add, and noise."""
    errors = noise * np.random.default_rng(seed).standard_normal((N, 3)) if errors is None else errors
    return 4e-5 + errors - np.einsum("k,knc->nc", truth["one"], ONE) - np.einsum("k,knc->nc", truth["two"], TWO)


def solved(y, blocks=BLOCKS, active=None):
    return System.of(y, blocks, project).solve(active or blocks)


def test_the_estimate_is_that_of_dense_weighted_least_squares_with_a_prior():
    y = field()
    found = solved(y)
    J = np.concatenate([ONE, TWO]).reshape(5, -1)
    scale = np.array([10e-6] * 3 + [0.1] * 2)
    W = np.repeat(WEIGHTS, 3)
    constants = np.tile(np.eye(3), (N, 1)).T
    # Constant fields are free, and everything is in units of what was expected.
    A = np.concatenate([J * scale[:, None], constants])
    prior = np.append(np.ones(5), np.zeros(3)) * found.noise_sd**2
    z = -np.linalg.solve((A * W) @ A.T + np.diag(prior), (A * W) @ y.ravel())[:5] * scale
    np.testing.assert_allclose(np.concatenate([found.estimate["one"], found.estimate["two"]]), z, rtol=1e-3)
    np.testing.assert_allclose(found.estimate["one"], TRUTH["one"], atol=4 * NOISE / np.sqrt(N))
    np.testing.assert_allclose(found.residual, project((y + np.einsum("k,knc->nc", z[:3], ONE)
                               + np.einsum("k,knc->nc", z[3:], TWO))[None])[1][0], atol=1e-9)  # fmt: skip
    assert found.noise_sd == pytest.approx(NOISE, rel=0.1)
    assert not any(o.any() for o in found.is_open.values())


def test_estimates_scatter_as_stated_and_what_is_not_there_is_shown_as_often_as_chance_has_it():
    none = {"one": np.zeros(3), "two": np.zeros(2)}
    found = [solved(field(seed=100 + k, truth=none)) for k in range(60)]
    z = np.array([f.estimate["one"] / f.sd["one"] for f in found])
    # The worst of three numbers of stretches makes it a little wide.
    assert 0.6 < np.mean(z**2) < 1.1
    p = np.array([f.p_value["two"] for f in found])
    assert (p < 0.1).mean() < 0.2
    assert (p > 0.5).mean() > 0.4
    assert solved(field()).p_value["one"] < 1e-6
    lone = solved(
        field(truth={"one": TRUTH["one"], "two": np.array([5e-3, 0.0])}),
        BLOCKS | {"two": ParameterBlock(TWO[:1], 0.1)},
    )
    z = lone.estimate["two"] / lone.sd["two"]
    assert lone.p_value["two"] == pytest.approx(scipy.stats.f.sf(z[0] ** 2, 1, 19), rel=1e-6)
    assert 1e-6 < lone.p_value["two"] < 0.05


def test_errors_that_are_alike_along_the_path_widen_what_is_stated():
    """Of columns as slow as the errors are, against the scatter of the estimates themselves."""
    slow = np.sin(np.arange(N)[:, None] / 25 + np.arange(3))[None]
    blocks = {"slow": ParameterBlock(slow, 10e-6)}
    estimates, stated = [], []
    for seed in range(60):
        rng = np.random.default_rng(seed)
        drift = np.repeat(rng.standard_normal((N // 40, 3)), 40, axis=0)
        y = 4e-5 + NOISE * (drift + 0.5 * rng.standard_normal((N, 3)))
        found = solved(y, blocks)
        estimates.append(found.estimate["slow"][0])
        stated.append(found.sd["slow"][0])
    assert 0.9 < np.mean(stated) / np.std(estimates) < 2.0
    alone = solved(field(), BLOCKS)
    assert np.mean(stated) > 3 * NOISE / np.sqrt(3 * N * slow.var())
    assert alone.sd["one"].max() < 3 * NOISE / np.sqrt(3 * N)


def test_what_the_data_leave_open_stays_at_zero_with_the_spread_it_had():
    copy = {"one": ParameterBlock(ONE[:1], 10e-6), "constant": ParameterBlock(np.ones((1, N, 3)), 5e-6)}
    found = solved(field(truth={"one": TRUTH["one"] * [1, 0, 0], "two": np.zeros(2)}), copy)
    assert found.is_open["constant"].tolist() == [True]
    assert found.is_open["one"].tolist() == [False]
    assert found.estimate["constant"][0] == pytest.approx(0, abs=1e-12)
    assert found.sd["constant"][0] == pytest.approx(5e-6)
    assert found.p_value["constant"] == pytest.approx(1.0)


@pytest.mark.parametrize(("times", "is_open"), [(1.0, True), (4.0, True), (7.0, False)])
def test_a_direction_is_fixed_where_the_data_know_it_five_times_better_than_before(times, is_open):
    column = np.random.default_rng(3).standard_normal((1, N, 3))
    size = times * NOISE / np.sqrt(3 * N)
    y = 4e-5 + NOISE * np.random.default_rng(4).standard_normal((N, 3))
    found = solved(y, {"one": ParameterBlock(column, size)})
    assert found.is_open["one"].tolist() == [is_open]
    assert found.noise_sd == pytest.approx(NOISE, rel=0.1)
