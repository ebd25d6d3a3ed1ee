# SPDX-License-Identifier: BSD-3-Clause
"""Local reference frames."""

import numpy as np

from magmatch.features.config import FeatureConfig
from magmatch.features.infer import infer
from magmatch.features.local_frames import frame_axes

FINE = FeatureConfig(spacing=0.08)


def frames_of(field, neighbours, distance=(1.0, 2.0), frame_sd=2.0):
    return frame_axes(np.array(field), np.array([0]), np.array(neighbours), np.array(distance), frame_sd)


def test_axes_follow_the_printed_recipe():
    field = [[0, 0, 2e-5], [1e-5, 0, 3e-5], [0, 4e-5, -1e-5]]
    frames, strength = frames_of(field, [[1, 2]])
    near, far = np.exp(-1 / 8), np.exp(-4 / 8)
    x = np.array([near * 1, far * 4, 0]) / np.hypot(near, 4 * far)
    np.testing.assert_allclose(frames[0].T, [x, np.cross([0, 0, 1], x), [0, 0, 1]])
    np.testing.assert_allclose(strength[0], np.hypot(near, 4 * far) / (near + 4 * far))


def test_points_outside_the_map_do_not_count():
    field = [[0, 0, 2e-5], [1e-5, 0, 3e-5], [0, 4e-5, -1e-5]]
    frames, _ = frames_of(field, [[1, -1]])
    np.testing.assert_allclose(frames[0, :, 0], [1, 0, 0])


def test_a_field_that_vanishes_or_has_no_lateral_part_gives_no_frame():
    for field in ([[0, 0, 0], [1e-5, 0, 0], [0, 1e-5, 0]], [[0, 0, 1e-5], [0, 0, 2e-5], [0, 0, 3e-5]]):
        _, strength = frames_of(np.array(field, dtype=float), [[1, 2]])
        assert not (strength > 0.0).any()


def test_a_whole_support_in_air_says_little_about_the_x_axis(make_map):
    # Components of B are harmonic, so their weighted mean over a ball is the value at its centre, which projects to
    # nothing: only supports that the region's edge cuts have a strong sum.
    field_map = make_map(3)
    points = infer(field_map, FINE)
    rows = np.arange(len(points))
    neighbours, distance = points.support(rows, 3.0)
    _, strength = frame_axes(points.field, rows, neighbours, distance, 1.5)
    n_there = (neighbours >= 0).sum(axis=1)
    is_whole = n_there == neighbours.shape[1]
    assert is_whole.sum() > 50
    assert np.median(strength[is_whole]) < 0.1
    assert np.median(strength[n_there < 0.7 * neighbours.shape[1]]) > 0.3
