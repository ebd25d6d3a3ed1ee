# SPDX-License-Identifier: BSD-3-Clause
"""Cubes of a lattice: which points share one, one point of each, sums over each."""

import numpy as np
import pytest

from magmatch.estimation.cubes import cube_keys, sum_by_cube, thin

POINTS = np.random.default_rng(0).uniform(-3, 3, (300, 3))
CUBES = [tuple(c) for c in np.floor(POINTS / 0.9).astype(int)]


def test_points_share_a_key_where_they_share_a_cube_and_nowhere_else():
    keys = cube_keys(POINTS, 0.9)
    assert len(set(zip(keys.tolist(), CUBES, strict=True))) == len(set(keys.tolist())) == len(set(CUBES))


def test_the_first_point_of_each_cube_is_kept_in_the_order_given():
    first = sorted(CUBES.index(cube) for cube in set(CUBES))
    assert thin(POINTS, 0.9, 1000).tolist() == first
    assert thin(POINTS, 0.9, len(first)).tolist() == first


def test_where_too_many_are_kept_the_cubes_grow_until_few_enough_are():
    n = len(set(CUBES))
    assert 0.4 * n < len(thin(POINTS, 0.9, n - 1)) < n


def test_rows_are_added_up_over_their_cubes():
    rows = np.random.default_rng(1).normal(size=(300, 4))
    expected = [rows[[c == cube for c in CUBES]].sum(axis=0) for cube in set(CUBES)]
    found = sum_by_cube(rows, POINTS, 0.9)
    assert found.shape == (len(expected), 4)
    np.testing.assert_allclose(sorted(found.tolist()), sorted(np.array(expected).tolist()), atol=1e-12)


@pytest.mark.parametrize("shift", [[0, 0, 0.9], [0, -0.9, 0], [9.0, 0, 0]])
def test_a_lattice_looks_the_same_from_every_cube(shift):
    np.testing.assert_array_equal(thin(POINTS, 0.9, 1000), thin(POINTS + shift, 0.9, 1000))
