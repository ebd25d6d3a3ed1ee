# SPDX-License-Identifier: BSD-3-Clause
"""The evidence of the spline prior's numbers, and how many samples of a path count as one."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.stats import multivariate_normal

from magmatch.field.cholesky.multifrontal import factorise
from magmatch.field.hyperparameters import Hyperparameters
from magmatch.field.selection import spline_evidence
from magmatch.field.selection.spline_evidence import EvidenceSearch, integrated_autocorrelation_time
from magmatch.field.selection.spline_hyperparameters import choose_spline_hyperparameters
from magmatch.field.spline.spline_model import SplineModel
from oracles.dense_matrix import to_dense

H = Hyperparameters(0.5, 3e-6, 0.5e-6, 0.3, reach=1.0, divergence_weight=30.0)


def draw(n=60, seed=0):
    """Samples of a field drawn from the prior itself."""
    rng = np.random.default_rng(seed)
    x = rng.uniform(0, 1, (n, 3))
    return x, dense_field(x, rng)


def dense_covariance(x, h):
    """Prior covariance of the measured values, by unit weights one at a time."""
    model = SplineModel.over(x, h)
    posterior = model.infer(model.observe(x[:0], x[:0]))
    m = len(posterior.weights)
    Phi = np.stack([posterior.evaluate(x, 0, row).field.ravel() for row in np.eye(m)], axis=1)
    P = to_dense(model.prior_precision(), model.cells) / h.noise_sd**2
    return Phi @ np.linalg.solve(P, Phi.T) + h.noise_sd**2 * np.eye(3 * len(x))


def dense_field(x, rng):
    K = dense_covariance(x, H)
    return (np.linalg.cholesky(K) @ rng.standard_normal(len(K))).reshape(-1, 3)


@pytest.mark.parametrize("factor", [0.3, 1.0, 4.0])
def test_evidence_differences_equal_those_of_the_dense_gaussian_at_the_best_noise(factor):
    x, b = draw()
    search = EvidenceSearch(x, b, np.arange(len(x)))

    def dense(h):
        # Everything scales with the noise, so the dense density at the profiled level is what evidence says.
        scale = search.noise_sd(h) / h.noise_sd
        return multivariate_normal(None, dense_covariance(x, h) * scale**2).logpdf(b.ravel())

    other = replace(H, lengthscale=H.lengthscale * factor, noise_sd=H.noise_sd * factor)
    expected = dense(other) - dense(H)
    assert search.log_evidence(other) - search.log_evidence(H) == pytest.approx(expected, abs=1e-5)


@pytest.mark.parametrize("signal_to_noise", [1.0, 1e4])
def test_single_precision_tells_the_same_evidence(signal_to_noise):
    """To a quarter of a nat, where a move has to gain two."""
    x, b = draw(400, seed=5)
    h = replace(H, noise_sd=H.signal_sd / signal_to_noise, divergence_weight=3000.0)
    double, single = (EvidenceSearch(x, b, np.arange(len(x)), precision) for precision in (np.float64, np.float32))
    assert single.log_evidence(h) == pytest.approx(double.log_evidence(h), rel=0, abs=0.25)
    assert single.noise_sd(h) == pytest.approx(double.noise_sd(h), rel=1e-4)


@pytest.mark.parametrize(("autocorrelation_time", "factor"), [(1.0, 0.1), (4.0, 1.0), (1.0, 5.0)])
def test_slopes_are_those_of_the_evidence_as_far_as_few_random_vectors_tell(factor, autocorrelation_time):
    x, b = draw(300, seed=4)
    search, h = EvidenceSearch(x, b, np.arange(len(x))), replace(H, noise_sd=factor * H.noise_sd)
    search.autocorrelation_time = autocorrelation_time
    step = 0.05

    def derivatives(f):
        low, here, high = (f(replace(h, noise_sd=h.noise_sd * np.exp(k * step))) for k in (-1, 0, 1))
        return (high - low) / (2 * step), (high - 2 * here + low) / step**2

    slopes, found = derivatives(search.log_evidence_of_noise), search.noise_slopes(h)
    # In nats per logarithm, of 900 measured values: what four random vectors miss a trace by.
    assert found.evidence == pytest.approx(slopes, abs=15)
    # No trace in these.
    assert found.level == pytest.approx(derivatives(lambda h: np.log(search.noise_sd(h))), rel=0.01, abs=1e-3)
    assert search.noise_slopes(h) == found


@given(share=st.floats(0.2, 0.75), scale=st.floats(1e-9, 1e3))
@settings(max_examples=10, deadline=None)
def test_an_autoregression_counts_as_its_correlation_time(share, scale):
    rng = np.random.default_rng(1)
    r = rng.standard_normal((20_000, 3))
    for n in range(1, len(r)):
        r[n] += share * r[n - 1]
    assert integrated_autocorrelation_time(scale * r, np.arange(len(r))) == pytest.approx(
        (1 + share) / (1 - share), rel=0.2
    )


def test_samples_beyond_a_gap_of_the_path_are_no_neighbours():
    r = np.repeat(np.random.default_rng(2).standard_normal((500, 3)), 2, axis=0)
    together = np.arange(1000)
    apart = 2 * together
    assert integrated_autocorrelation_time(r, together) > 1.5
    assert integrated_autocorrelation_time(r, apart) == 1.0


def test_what_is_left_out_in_single_precision_is_predicted_as_by_a_fit_of_the_rest():
    x, b = draw(200, seed=7)
    rows = np.arange(200) % 5 == 0
    search = EvidenceSearch(x, b, np.arange(200), np.float32)
    model = SplineModel.over(x, H)
    expected = model.infer(model.observe(x[~rows], b[~rows]))
    posterior = search.fit_without(rows, H)
    scale = np.abs(b).max()
    assert posterior.evaluate(x[rows]).field == pytest.approx(expected.evaluate(x[rows]).field, abs=1e-5 * scale)
    # Variances in single precision: differences of large numbers.
    assert posterior.covariance(x[rows]) == pytest.approx(expected.covariance(x[rows]), abs=0.01 * H.noise_sd**2)


def test_samples_are_left_out_in_double_precision_where_single_precision_has_no_factor(monkeypatch):
    def of_doubles_alone(elimination, matrix, precision=np.float64):
        if precision == np.float32:
            msg = "matrix is not positive definite"
            raise np.linalg.LinAlgError(msg)
        return factorise(elimination, matrix, precision)

    x, b = draw(60, seed=7)
    rows = np.arange(60) % 5 == 0
    monkeypatch.setattr(spline_evidence, "factorise", of_doubles_alone)
    single, double = (EvidenceSearch(x, b, np.arange(60), p).fit_without(rows, H) for p in (np.float32, np.float64))
    np.testing.assert_array_equal(single.evaluate(x[rows]).field, double.evaluate(x[rows]).field)


def test_a_path_that_never_returns_says_nothing_and_is_fitted_all_the_same():
    x = np.linspace(0, 1, 45)[:, None] * [1.0, 0.0, 0.0]
    b = 1e-6 * np.sin(20 * x)
    h = choose_spline_hyperparameters(x, b)
    assert all(np.isfinite(v) and v > 0 for v in h.as_dict().values())
