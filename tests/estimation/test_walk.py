# SPDX-License-Identifier: BSD-3-Clause
"""A survey in bins along its path, and what counts as a line."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from magmatch.data.survey import Survey
from magmatch.estimation.walk import bin_along_path, choose_search, is_resolved, line_share, walk_of


def straight(n=200, length=3.0):
    x = np.zeros((n, 3))
    x[:, 0] = np.linspace(0, length, n)
    return x


def some_survey():
    rng = np.random.default_rng(0)
    x = straight() + 0.02 * rng.standard_normal((200, 3))
    x = Rotation.from_euler("xyz", [0.3, -0.5, 1.0]).apply(x) + np.array([5.0, -2.0, 1.0])
    return Survey(x, 4e-5 * rng.standard_normal((200, 3)), pose_sd=0.03)


def test_a_bin_begins_where_a_sample_is_farther_than_its_side_from_the_first():
    x = np.array([[0, 0, 0], [0.3, 0, 0], [0, 0.4, 0.3], [0, 0.4, 0.31], [0, 0.4, 0.9], [0, 1.2, 0.31]])
    assert bin_along_path(x, 0.5).tolist() == [0, 0, 0, 1, 2, 3]


def test_a_walk_is_the_mean_of_its_bins_in_its_principal_frame():
    survey = some_survey()
    walk = walk_of(survey, 2.0)
    rows = bin_along_path(survey.transformed(walk.T_survey_walk.inv()).positions, 0.3)
    assert len(walk) == rows[-1] + 1 < 12
    for k in range(len(walk)):
        some = survey.subset(np.flatnonzero(rows == k))
        np.testing.assert_allclose(
            walk.T_survey_walk.apply(walk.positions[k]), some.positions.mean(axis=0), atol=1e-12
        )
        np.testing.assert_allclose(
            walk.T_survey_walk.rotation.apply(walk.field[k]), some.field.mean(axis=0), atol=1e-18
        )
    assert walk.pose_sd == 0.03


def test_a_long_walk_gets_as_many_bins_as_there_may_be_and_a_bin_is_as_long_as_its_step():
    walk = walk_of(Survey(straight(4000, 60.0), np.ones((4000, 3))), 1.0)
    assert 100 < len(walk) <= 150
    assert walk.bin_length == pytest.approx(60.0 / len(walk), rel=0.02)
    assert walk_of(Survey(straight(3, 0.01), np.ones((3, 3))), 1.0).bin_length == 0.0


@pytest.mark.parametrize(("breadth", "is_line"), [(0.17, True), (0.23, False)])
def test_samples_lie_on_a_line_where_they_spread_across_it_by_less_than_a_fifth_of_the_radius(breadth, is_line):
    x = straight(900)
    # Two rows: their spread across is half their distance.
    x[::2, 1], x[1::2, 1] = -breadth * 0.5, breadth * 0.5
    assert line_share(x, 0.5) == is_line


def test_a_short_line_is_searched_by_pairs_and_a_long_one_by_invariants():
    field = np.ones((9000, 3))
    assert choose_search(Survey(straight(9000, 40.0), field), 1.0) == "pairs"
    assert choose_search(Survey(straight(9000, 50.0), field), 1.0) == "invariants"


def test_a_path_is_resolved_by_bins_of_a_correlation_length_unless_it_is_too_long_or_in_no_order():
    field, positions = np.ones((9000, 3)), straight(9000, 140.0)
    assert is_resolved(Survey(positions, field), 1.0)
    assert not is_resolved(Survey(straight(9000, 160.0), field), 1.0)
    assert not is_resolved(Survey(np.random.default_rng(0).permutation(positions), field), 1.0)
