import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from magmatch.registration.search.kdtree import NeighbourTree


@settings(max_examples=40, deadline=None)
@given(n=st.integers(1, 400), d=st.integers(1, 8), n_values=st.sampled_from([3, 1000]), seed=st.integers(0, 2**20))
def test_neighbours_are_those_of_an_exhaustive_search(n, d, n_values, seed):
    """Few distinct values make ties and empty splits."""
    rng = np.random.default_rng(seed)
    points, targets = (rng.integers(0, n_values, (m, d)).astype(np.float32) for m in (n, 20))
    k = min(5, n)
    found, distance2 = NeighbourTree.of(points).query(targets, k)
    distance = np.linalg.norm(points[found].astype(float) - targets[:, None], axis=2)
    every = np.sort(np.linalg.norm(points[None].astype(float) - targets[:, None], axis=2), axis=1)[:, :k]
    np.testing.assert_allclose(distance, every, atol=1e-6)
    np.testing.assert_allclose(np.sqrt(distance2), every, atol=1e-6)
    assert all(len(set(row)) == k for row in found.tolist())


def test_more_neighbours_than_points_are_refused():
    with pytest.raises(ValueError, match="at most as many"):
        NeighbourTree.of(np.zeros((3, 2))).query(np.zeros((1, 2)), 4)


def test_one_leaf_is_enough_to_find_a_point_of_the_tree_and_finds_none_nearer_than_the_nearest():
    rng = np.random.default_rng(2)
    tree = NeighbourTree.of(points := rng.standard_normal((5_000, 7)).astype(np.float32))
    np.testing.assert_array_equal(tree.query(points, 1, n_leaves=1)[1], 0.0)
    targets = rng.standard_normal((200, 7))
    near, nearest = tree.query(targets, 1, n_leaves=1)[1], tree.query(targets, 1)[1]
    assert (near >= nearest).all()
    assert (near > nearest).any()
