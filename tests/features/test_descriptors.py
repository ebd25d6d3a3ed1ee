# SPDX-License-Identifier: BSD-3-Clause
"""Histograms of oriented vectors."""

import numpy as np
import pytest

from magmatch.features.descriptors import component_range, histograms_of_oriented_vectors

IDENTITY = np.eye(3)[None]


def describe(vectors, half_range=1.0, frame=IDENTITY, extra=()):
    vectors = np.array(vectors, dtype=float)
    neighbours = np.array([[*range(len(vectors)), *extra]])
    return histograms_of_oriented_vectors(vectors, neighbours, frame, half_range)[0]


def spherical(azimuth_deg, elevation_deg, norm=0.5):
    a, e = np.radians(azimuth_deg), np.radians(elevation_deg)
    return norm * np.array([np.cos(a) * np.cos(e), np.sin(a) * np.cos(e), np.sin(e)])


@pytest.mark.parametrize(
    ("azimuth", "elevation", "bins"), [(-179, -89, (0, 0)), (-1, -1, (9, 4)), (1, 1, (10, 5)), (179, 89, (19, 9))]
)
def test_angles_fall_into_bins_of_eighteen_degrees(azimuth, elevation, bins):
    h = describe([spherical(azimuth, elevation)])
    assert np.flatnonzero(h[:20]).tolist() == [bins[0]]
    assert np.flatnonzero(h[20:30]).tolist() == [bins[1]]


def test_components_fall_into_twenty_bins_over_the_range():
    h = describe([[-95e-4, 5e-4, 95e-4]], half_range=100e-4)  # the printed +-100 G in bins of 10 G
    assert np.flatnonzero(h[30:50]).tolist() == [0]
    assert np.flatnonzero(h[50:70]).tolist() == [10]
    assert np.flatnonzero(h[70:90]).tolist() == [19]


def test_missing_points_of_the_support_do_not_count():
    vectors = [spherical(30, 10), spherical(100, -40)]
    assert np.array_equal(describe(vectors), describe(vectors, extra=(-1, -1)))


def test_vectors_are_seen_from_the_local_frame():
    frame = np.array([[[0.0, 0, 1], [1, 0, 0], [0, 1, 0]]])
    seen = spherical(40, 20)
    assert np.array_equal(describe([frame[0] @ seen], frame=frame), describe([seen]))


def test_straight_up_falls_into_the_last_elevation_bin():
    assert describe([[0.0, 0.0, 0.5]])[29] == 1.0


def test_the_range_ignores_the_strongest_two_percent():
    field = np.tile([3e-5, 0, 4e-5], (1000, 1))
    field[:5] *= 100
    np.testing.assert_allclose(component_range(field), 5e-5)
