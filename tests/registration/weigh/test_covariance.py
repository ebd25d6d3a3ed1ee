# SPDX-License-Identifier: BSD-3-Clause
"""Of two covariances the enclosing one is below neither, and no larger than it must be."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from magmatch.registration.weigh.covariance import enclosing

SCALE = np.array([1e-3, 2e-3, 1e-3, 0.01, 0.03, 0.02])


def drawn(seed, rank=6):
    """Covariance of six numbers in units of rad and m."""
    root = np.random.default_rng(seed).standard_normal((6, rank)) * SCALE[:, None]
    return root @ root.T


def smallest(difference):
    """Least eigenvalue in units of the scale."""
    return np.linalg.eigvalsh(difference / np.outer(SCALE, SCALE)).min()


@given(st.integers(0, 2**32 - 1), st.integers(0, 2**32 - 1), st.integers(1, 6))
def test_it_is_below_neither(first, second, rank):
    one, other = drawn(first), drawn(second, rank)
    both = enclosing(one, other)
    assert smallest(both - one) > -1e-9
    assert smallest(both - other) > -1e-9
    assert smallest(one + other - both) > -1e-9


@given(st.integers(0, 2**32 - 1), st.floats(0, 1))
def test_what_is_enclosed_already_changes_nothing(seed, share):
    one = drawn(seed)
    np.testing.assert_allclose(enclosing(one, share * one), one, rtol=1e-9, atol=1e-15)


@given(st.integers(0, 2**32 - 1), st.floats(1, 1e6))
def test_a_multiple_encloses(seed, factor):
    one = drawn(seed)
    np.testing.assert_allclose(enclosing(one, factor * one), factor * one, rtol=1e-6, atol=1e-12 * factor)


@given(st.integers(0, 2**32 - 1), st.integers(0, 2**32 - 1), st.integers(0, 2**32 - 1))
def test_it_turns_with_the_axes(first, second, turn):
    Q = np.linalg.qr(np.random.default_rng(turn).standard_normal((6, 6)))[0]
    one, other = (drawn(seed) / np.outer(SCALE, SCALE) for seed in (first, second))
    turned = enclosing(Q @ one @ Q.T, Q @ other @ Q.T)
    np.testing.assert_allclose(turned, Q @ enclosing(one, other) @ Q.T, rtol=1e-6, atol=1e-6 * np.abs(turned).max())


def test_nothing_known_of_one_leaves_the_other():
    one, other = np.diag([0.0, *np.ones(5)]), np.eye(6)
    np.testing.assert_allclose(enclosing(one, other), np.eye(6), atol=1e-9)


def test_a_direction_that_is_known_exactly_is_kept():
    one, other = np.diag([0.0, *np.ones(5)]), np.diag([0.0, 4.0, *0.5 * np.ones(4)])
    assert np.diag(enclosing(one, other)) == pytest.approx([0, 4, 1, 1, 1, 1], abs=1e-9)
