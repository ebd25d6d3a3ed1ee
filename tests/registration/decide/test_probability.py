"""Claims about the stated probability: it follows the evidence, and poses that exclude each other share it."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from magmatch.registration.decide.probability import pose_probability, shares, walk_probability

odds = st.floats(-100, 1000)


@given(low=odds, high=odds, misfit=st.floats(0.2, 30), share=st.floats(0, 1))
def test_more_evidence_is_never_less_probable(low, high, misfit, share):
    low, high = sorted((low, high))
    assert pose_probability(low, None, misfit, share) <= pose_probability(high, None, misfit, share)


@given(low=odds, high=odds, residual=st.floats(0, 10), coverage=st.floats(0, 1))
def test_more_evidence_of_a_walk_is_never_less_probable(low, high, residual, coverage):
    low, high = sorted((low, high))
    assert 0 <= walk_probability(low, residual, coverage) <= walk_probability(high, residual, coverage) <= 1
    assert walk_probability(-np.inf, residual, coverage) == 0


@given(log_odds=odds, decoy_evidence=st.floats(-50, 200), misfit=st.floats(0.2, 30))
def test_what_chance_reaches_and_residuals_nothing_explains_speak_against_a_pose(log_odds, decoy_evidence, misfit):
    p = pose_probability(log_odds, None, misfit, 0.9)
    assert 0 <= pose_probability(log_odds, decoy_evidence, misfit, 0.9) <= p <= 1
    assert pose_probability(log_odds, None, 2 * misfit, 0.9) <= p


@given(st.lists(odds, min_size=1, max_size=6))
def test_poses_that_exclude_each_other_share_one_probability_in_their_order(values):
    values = sorted(values, reverse=True)
    found = shares(values)
    assert sum(found) == pytest.approx(1)
    assert found == sorted(found, reverse=True)


def test_equal_rooms_are_equally_probable_and_no_pose_elsewhere_takes_nothing():
    np.testing.assert_allclose(shares([300.0, 300.0, 300.0]), 1 / 3)
    assert shares([300.0, -np.inf]) == [1.0, 0.0]
    assert shares([-np.inf]) == [1.0]


def test_no_evidence_at_all_is_no_probability():
    assert pose_probability(-np.inf, None, np.inf, 0.0) == 0.0


def test_chance_is_improbable_and_clear_evidence_is_not():
    """The ends of the scale, whatever the weights between them: no margin over chance, and a wide one."""
    assert pose_probability(0.0, None, 1.0, 1.0) < 0.1
    assert pose_probability(60.0, 60.0, 1.0, 1.0) < 0.1
    assert pose_probability(15.0, None, 3.0, 0.8) < 0.5 < pose_probability(40.0, None, 1.0, 0.8)
    assert pose_probability(150.0, 20.0, 1.0, 0.95) > 0.99
    assert walk_probability(0.0, 1.0, 0.5) < 0.5
    assert walk_probability(-20.0, 1.0, 1.0) < 0.01
    assert walk_probability(40.0, 1.0, 0.9) > 0.99


def test_chance_counts_as_much_as_evidence_and_never_helps():
    assert pose_probability(60.0, 20.0, 1.2, 0.9) == pytest.approx(pose_probability(40.0, None, 1.2, 0.9))
    assert pose_probability(60.0, -40.0, 1.2, 0.9) == pose_probability(60.0, None, 1.2, 0.9)


@given(log_odds=odds, misfit=st.floats(0.2, 30), low=st.floats(0, 1), high=st.floats(0, 1))
def test_more_agreement_is_never_less_probable(log_odds, misfit, low, high):
    low, high = sorted((low, high))
    assert pose_probability(log_odds, None, misfit, low) <= pose_probability(log_odds, None, misfit, high)
    assert walk_probability(log_odds, misfit, low) <= walk_probability(log_odds, misfit, high)
    assert walk_probability(log_odds, 2 * misfit, high) <= walk_probability(log_odds, misfit, high)


def test_a_rival_a_twelfth_of_the_odds_behind_is_a_factor_e_less_probable():
    one, other = shares([120.0, 110.0])
    assert one / other == pytest.approx(np.e)
    # Odds that are next to nothing are compared as if they were fifteen nats.
    one, other = shares([3.0, 1.75])
    assert one / other == pytest.approx(np.e)
