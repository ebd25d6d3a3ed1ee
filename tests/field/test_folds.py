# SPDX-License-Identifier: BSD-3-Clause
"""What is left out of a survey."""

import numpy as np
import pytest

from magmatch.field.folds import divide, has_path_order, path_segments

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
