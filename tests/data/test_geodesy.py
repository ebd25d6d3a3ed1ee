# SPDX-License-Identifier: BSD-3-Clause
"""Degrees of latitude and longitude become metres on the spot."""

import numpy as np
import pytest
from scipy.spatial.distance import pdist

from magmatch.data.geodesy import Origin, local_east_north, local_east_north_up

ORIGIN = Origin(48.137154, 11.576124, 519.0)


def test_small_steps_are_as_long_as_the_radii_of_curvature_say():
    # Meridian and normal radius at 48.137154 degrees on WGS 84, by the textbook formulae with a and b.
    a, b = 6378137.0, 6356752.314245
    phi, step = np.radians(48.137154), np.radians(1e-5)
    w = np.sqrt((a * np.cos(phi)) ** 2 + (b * np.sin(phi)) ** 2)
    north, east = ((a * b) ** 2 / w**3 + 519.0) * step, (a**2 / w + 519.0) * np.cos(phi) * step
    at = local_east_north(np.array([48.137164, 48.137154]), np.array([11.576124, 11.576134]), ORIGIN)
    assert at == pytest.approx(np.array([[0.0, north], [east, 0.0]]), abs=1e-6)


def test_distances_do_not_depend_on_the_origin():
    rng = np.random.default_rng(0)
    places = 48.1 + rng.uniform(0, 0.05, 20), 11.5 + rng.uniform(0, 0.05, 20), rng.uniform(0, 600, 20)
    apart = [pdist(local_east_north_up(*places, o)) for o in (ORIGIN, Origin(48.0, 11.6), Origin(47.0, 12.0, 50.0))]
    assert apart[1] == pytest.approx(apart[0], abs=1e-7)
    assert apart[2] == pytest.approx(apart[0], abs=1e-7)


def test_places_on_both_sides_of_the_date_line_are_neighbours():
    east = local_east_north(np.array([-17.0, -17.0]), np.array([179.9999, -179.9999]), Origin(-17.0, 180.0))[:, 0]
    assert east == pytest.approx([-10.65, 10.65], abs=0.01)
