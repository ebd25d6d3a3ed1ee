# SPDX-License-Identifier: BSD-3-Clause
"""Parts of surveys, and how densely samples lie."""

import numpy as np
import pytest

from magmatch.field.subset import choose_part, sample_distance


def test_part_has_about_the_samples_asked_for():
    walk = np.c_[np.linspace(0, 20, 2000), np.sin(np.linspace(0, 9, 2000)), np.zeros(2000)]
    part = choose_part(walk, 600, 3)
    assert 300 <= part.sum() <= 600


@pytest.mark.parametrize("n", [300, 3000])
def test_the_distance_of_samples_anywhere_is_the_side_of_the_cube_that_each_has(n):
    x = np.random.default_rng(0).uniform(0, 2.0, (n, 3))
    # At the rim neighbours are missing.
    assert sample_distance(x) == pytest.approx((8.0 / n) ** (1 / 3), rel=0.2)
    assert sample_distance(10 * x) == pytest.approx(10 * sample_distance(x))


@pytest.mark.parametrize("n", [1, 40, 200])
def test_one_place_is_the_samples_nearest_to_the_one_in_the_middle(n):
    points = np.random.default_rng(1).normal(size=(200, 3))
    middle = points[np.argmin(np.linalg.norm(points - np.median(points, axis=0), axis=1))]
    away = np.linalg.norm(points - middle, axis=1)
    np.testing.assert_array_equal(choose_part(points, n, 1), away <= np.sort(away)[n - 1])
