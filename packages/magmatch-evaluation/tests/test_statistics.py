# SPDX-License-Identifier: BSD-3-Clause
"""Intervals, spreads and counts: against an oracle, and with failures that may not vanish."""

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.stats import binomtest

from magmatch_evaluation.experiments import Tolerance
from magmatch_evaluation.rows import Row
from magmatch_evaluation.statistics import spread, summarize, wilson_interval


def row(distance=0.01, angle=0.01, *, is_accepted=True, is_there=True, status="accepted", nees=1.0, seed=0):
    return Row("e", "m", seed, "d", status, "", is_accepted, is_there, distance, angle, nees, 9, 9, 1.0, 100)


@given(st.integers(1, 400), st.data())
def test_wilson_interval_equals_that_of_scipy(n, data):
    k = data.draw(st.integers(0, n))
    expected = binomtest(k, n).proportion_ci(0.95, method="wilson")
    assert wilson_interval(k, n) == pytest.approx((expected.low, expected.high), abs=1e-12)


def test_nothing_tried_says_nothing():
    assert wilson_interval(0, 0) == (0.0, 1.0)


@given(st.lists(st.floats(0, 1e3), min_size=1, max_size=50), st.integers(0, 50))
def test_failures_never_improve_a_spread(errors, n_failures):
    clean, with_failures = spread(errors), spread([*errors, *[math.inf] * n_failures])
    assert with_failures.median >= clean.median
    assert with_failures.p95 >= clean.p95
    assert with_failures.rmse == pytest.approx(clean.rmse, rel=1e-12)


@given(st.lists(st.floats(0, 1e3), min_size=1, max_size=50))
def test_squared_rmse_is_squared_mean_plus_variance(errors):
    found = spread(errors)
    assert found.rmse**2 == pytest.approx(np.mean(errors) ** 2 + found.sd**2, rel=1e-9, abs=1e-12)


def test_half_failed_trials_have_no_p95_and_more_than_half_no_median():
    half = spread([1.0, 2.0, math.inf, math.inf])
    assert half.median == 2.0
    assert math.isinf(half.p95)
    assert math.isinf(spread([1.0, math.inf, math.inf]).median)


def test_counts_tell_right_wrong_refused_and_broken_apart():
    rows = [
        row(),
        row(distance=0.2),
        row(angle=math.radians(6)),
        row(is_accepted=False, status="inconsistent"),
        row(math.inf, math.inf, is_accepted=False, status="fault", nees=math.nan),
    ]
    found = summarize(rows, Tolerance(0.1, 5.0))
    assert (found.n, found.n_posed, found.n_right) == (5, 4, 1)
    assert (found.n_false, found.n_faults) == (2, 1)
    assert found.success == wilson_interval(1, 5)


def test_where_nothing_is_to_be_found_accepting_is_wrong_and_refusing_right():
    rows = [row(is_there=False), *(row(is_there=False, is_accepted=False, status="ambiguous") for _ in range(3))]
    found = summarize(rows, Tolerance())
    assert (found.n_right, found.n_false) == (0, 1)
    assert found.success == wilson_interval(3, 4)


def test_nees_is_of_accepted_answers_that_state_a_covariance():
    rows = [row(nees=2.0), row(nees=math.nan), row(nees=50.0, is_accepted=False)]
    assert summarize(rows, Tolerance()).nees == 2.0
