# SPDX-License-Identifier: BSD-3-Clause
"""Parts of surveys: what is left out, how densely samples lie, and the length over which a field changes."""

import numpy as np
import pytest

from magmatch.field.folds import divide, has_path_order, path_segments
from magmatch.field.subset import choose_part, sample_distance
from magmatch.field.variogram import typical_length

rng = np.random.default_rng(0)
CLOUD = rng.uniform(0, 3, (2000, 3))
WALK = np.c_[np.linspace(0, 20, 2000), np.sin(np.linspace(0, 9, 2000)), np.zeros(2000)]


def test_segments_are_contiguous_and_of_the_length_asked_for():
    segment = path_segments(WALK, 1.0)
    assert np.all(np.isin(np.diff(segment), [0, 1]))
    along = np.linalg.norm(np.diff(WALK, axis=0), axis=1)
    lengths = np.bincount(segment[1:], weights=along)
    assert np.all(np.abs(lengths - 1.0) < 0.15)


def test_parts_cover_a_survey_and_its_end():
    points = CLOUD
    folds = divide(points, 0.5)
    assert not folds.is_path
    assert len(folds.left_out) == 3
    end = folds.left_out[2]
    assert points[end, 0].min() >= points[~end, 0].max() - 1e-12
    assert divide(points[:20], 0.5).left_out == ()


def test_every_part_is_left_out_once_or_in_the_rest():
    folds = divide(CLOUD, 0.5)
    np.testing.assert_array_equal(np.sum([*folds.left_out[:2], *folds.rest], axis=0), 1)
    for fold in folds.left_out[:2]:
        assert not set(folds.part[fold]) & set(folds.part[~fold])


@pytest.mark.parametrize("unit", [1e-4, 1e4])
def test_order_and_parts_are_the_same_in_any_unit_of_length(unit):
    for points in (WALK, CLOUD):
        one, other = divide(points, 0.5), divide(unit * points, 0.5 * unit)
        assert has_path_order(unit * points) == has_path_order(points) == one.is_path == other.is_path
        assert len(one.left_out) == len(other.left_out)
        # Rounding may put a sample on the other side.
        for fold, scaled in zip(one.left_out, other.left_out, strict=True):
            assert np.mean(fold == scaled) > 0.99


def test_jumps_between_surveys_are_no_path_and_short_paths_have_ten_segments():
    apart = np.concatenate([WALK, WALK + np.array([500.0, 0, 0])])
    segment = path_segments(apart, 1.0)
    assert segment[-1] + 1 == pytest.approx(2 * (path_segments(WALK, 1.0)[-1] + 1), abs=3)
    assert path_segments(WALK, 1e3)[-1] == 9


def test_part_has_about_the_samples_asked_for():
    part = choose_part(WALK, 600, 3)
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


@pytest.mark.parametrize("length", [0.3, 0.6, 1.0])
def test_typical_length_of_a_squared_exponential_potential_is_its_lengthscale(length):
    draw = np.random.default_rng(1)
    k = draw.normal(size=(400, 3)) / length
    phase = draw.uniform(0, 2 * np.pi, 400)
    field = 1e-6 * np.sin(CLOUD @ k.T + phase) @ k
    assert typical_length(CLOUD, field) == pytest.approx(length, rel=0.35)


def test_a_few_spikes_do_not_change_the_typical_length():
    field = 1e-6 * np.sin(3 * CLOUD)
    spiked = field.copy()
    spiked[::100] += 1e-4
    assert typical_length(CLOUD, spiked) == pytest.approx(typical_length(CLOUD, field), rel=0.3)


def test_the_typical_length_of_many_samples_is_that_of_few():
    points = np.random.default_rng(3).uniform(0, 3, (24_000, 3))
    few = typical_length(points[::8], 1e-6 * np.sin(3 * points[::8]))
    assert typical_length(points, 1e-6 * np.sin(3 * points)) == pytest.approx(few, rel=0.15)
