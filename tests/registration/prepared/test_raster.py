# SPDX-License-Identifier: BSD-3-Clause
"""Trilinear look-ups against SciPy's and against finite differences, on values that follow no law."""

import numpy as np
from numba import typeof
from scipy.interpolate import RegularGridInterpolator

from magmatch.registration.prepared.raster import RASTER, Raster, find_cell, interpolate_field

ORIGIN, SPACING, SHAPE = np.array([0.3, -0.2, 0.1]), 0.25, (5, 4, 6)
RNG = np.random.default_rng(0)
VALUES, SD = RNG.normal(size=(*SHAPE, 3)), RNG.uniform(0.1, 1.0, SHAPE)


def raster_of(sd=SD):
    rows = np.flatnonzero(sd >= 0)
    return Raster.knowing(ORIGIN, SPACING, SHAPE, rows, VALUES.reshape(-1, 3)[rows], sd.ravel()[rows])


def points_inside(n=60, seed=1):
    return ORIGIN + np.random.default_rng(seed).uniform(0.01, 0.99, (n, 3)) * SPACING * (np.array(SHAPE) - 1)


def test_field_and_spread_are_the_trilinear_ones():
    axes = [ORIGIN[a] + SPACING * np.arange(SHAPE[a]) for a in range(3)]
    field, sd, _, is_known = raster_of().lookup(points_inside())
    assert is_known.all()
    np.testing.assert_allclose(field, RegularGridInterpolator(axes, VALUES)(points_inside()), atol=1e-12)
    np.testing.assert_allclose(sd, RegularGridInterpolator(axes, SD)(points_inside()), atol=1e-12)


def test_the_gradient_is_the_slope_of_the_field():
    # Away from the faces of cells, where it jumps.
    cell = np.random.default_rng(2).integers(0, np.array(SHAPE) - 1, (40, 3))
    points = ORIGIN + SPACING * (cell + np.random.default_rng(3).uniform(0.1, 0.9, (40, 3)))
    gradient, step = raster_of().lookup(points)[2], 1e-4
    for axis in range(3):
        ahead, behind = (raster_of().lookup(points + s * step * np.eye(3)[axis])[0] for s in (1, -1))
        np.testing.assert_allclose(gradient[:, :, axis], (ahead - behind) / (2 * step), atol=1e-8)


def test_a_cell_is_known_where_all_its_corners_are():
    for corner in np.ndindex(2, 2, 2):
        sd = SD.copy()
        sd[tuple(np.array([2, 1, 3]) + corner)] = -1.0
        inside = ORIGIN + SPACING * (np.array([2, 1, 3]) + 0.5)
        field, spread, gradient, is_known = raster_of(sd).lookup(inside[None])
        assert not is_known.any()
        assert not np.concatenate([v.ravel() for v in (field, spread, gradient)]).any()
        far = inside + SPACING * (1 - 2 * np.array(corner)) * [1, 0, 0]
        assert raster_of(sd).lookup(far[None])[3].all()


def test_a_search_is_told_the_same_field_as_who_asks_for_the_gradient_too():
    raster = raster_of()
    field, sd, _, _ = raster.lookup(points_inside())
    for k, point in enumerate(points_inside()):
        found = interpolate_field.py_func(raster.values, *find_cell.py_func(raster.values, ORIGIN, SPACING, *point))
        np.testing.assert_allclose(found, [*field[k], sd[k]], atol=1e-12)


def test_a_raster_that_cannot_be_written_as_of_a_file_is_no_other_type_to_loops():
    parts = [np.zeros(3), np.arange(8), np.zeros((8, 3)), np.ones(8)]
    for part in parts:
        part.flags.writeable = False
    raster = Raster.knowing(parts[0], 0.5, (2, 2, 2), *parts[1:])
    assert typeof(raster) == RASTER
