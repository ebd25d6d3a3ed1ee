# SPDX-License-Identifier: BSD-3-Clause
"""Correspondences in descriptor space."""

import numpy as np
import pytest
from scipy.spatial import cKDTree

from magmatch.published.matching import MatchingConfig, match

ALL = MatchingConfig(kept_share=1.0)


def column(descriptors):
    return np.array(descriptors, dtype=float)[:, None]


def rows(base, target, config=ALL):
    matches = match(column(base), column(target), config)
    return list(zip(matches.base_rows.tolist(), matches.target_rows.tolist(), strict=True))


def test_of_many_keypoints_each_finds_its_nearest_as_well():
    """More pairs than are compared at once."""
    rng = np.random.default_rng(1)
    base, target = rng.random((2000, 4)), rng.random((4500, 4))
    matches = match(base, target, ALL)
    distance, nearest = cKDTree(base).query(target)
    assert np.array_equal(matches.base_rows, nearest)
    assert np.array_equal(matches.target_rows, np.arange(4500))
    np.testing.assert_allclose(matches.distance, distance, atol=1e-12)


def test_the_closest_share_is_kept():
    assert rows([0, 100], [1, 2, 97, 104], MatchingConfig(kept_share=0.5)) == [(0, 0), (0, 1)]


def test_a_largest_distance_takes_the_place_of_the_share():
    assert rows([0, 100], [1, 2, 97, 104], MatchingConfig(max_distance=3.5)) == [(0, 0), (0, 1), (1, 2)]


@pytest.mark.parametrize(("n_base", "n_target"), [(0, 5), (5, 0), (0, 0)])
def test_no_keypoints_give_no_matches(n_base, n_target):
    matches = match(np.ones((n_base, 90)), np.ones((n_target, 90)), ALL)
    assert len(matches) == 0
