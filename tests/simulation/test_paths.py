# SPDX-License-Identifier: BSD-3-Clause
"""Paths: equal steps, right places, no jumps."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from magmatch.simulation.paths import around_loop, circles, heading_along, loop_length, resample, smooth_noise

SETTINGS = settings(deadline=None, max_examples=25)


def test_resampling_a_line_keeps_both_ends_and_equal_steps():
    corners = np.array([[0.0, 0, 0], [0.3, 0, 0], [3, 0, 0]])
    np.testing.assert_allclose(resample(corners, 7)[:, 0], np.linspace(0, 3, 7), atol=1e-12)


def test_circles_keep_radius_and_height_and_head_along_the_tangent():
    center = np.array([0.2, -0.1, 0.05])
    points = circles(center, (0.4,), 2, 500)
    heading, arm = heading_along(points), points - center
    np.testing.assert_allclose(np.linalg.norm(arm[:, :2], axis=1), 0.4, rtol=1e-3)  # chords of 2 degrees
    np.testing.assert_allclose(points[:, 2], 0.05, atol=1e-12)
    tangent = np.column_stack([-arm[:, 1], arm[:, 0]]) / 0.4
    travel = np.column_stack([np.cos(heading), np.sin(heading)])
    assert (np.einsum("ij,ij->i", tangent, travel) > 0.99).all()


@SETTINGS
@given(st.floats(0, 200), st.floats(0.2, 3))
def test_loop_has_no_jumps_and_heads_where_it_goes(start, radius):
    size, h = (20.0, 10.0), 1e-6
    before, heading = around_loop(size, radius, np.array([start]))
    after, _ = around_loop(size, radius, np.array([start + h]))
    step = (after - before)[0] / h
    # A step of a micrometre, rounded at 1e-15 of twenty metres.
    np.testing.assert_allclose(step, [np.cos(heading[0]), np.sin(heading[0]), 0], atol=1e-5)


def test_loop_stays_on_the_rectangle():
    points, _ = around_loop((20.0, 10.0), 1.0, np.linspace(0, 60, 2000))
    np.testing.assert_allclose(points.min(axis=0), [0, 0, 0], atol=1e-6)
    np.testing.assert_allclose(points.max(axis=0), [20, 10, 0], atol=1e-6)


def test_a_round_ends_where_it_began_however_its_sides_are_rounded():
    for radius in np.random.default_rng(0).uniform(0.2, 3, 300):
        end = np.nextafter(loop_length((20.0, 10.0), radius), 0)
        points, _ = around_loop((20.0, 10.0), radius, np.array([end]))
        np.testing.assert_allclose(points, [[radius, 0, 0]], atol=1e-9)


def test_smooth_noise_has_its_deviation_and_no_steps(rng):
    series = smooth_noise(3000, 15, 0.2, rng)
    assert series.std() == pytest.approx(0.2)
    assert np.abs(np.diff(series)).max() < 0.1 * 0.2 * 3
