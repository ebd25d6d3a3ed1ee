# SPDX-License-Identifier: BSD-3-Clause
"""Images and surfaces lie where they say."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial.transform import RigidTransform, Rotation

from magmatch.data.survey import Survey
from magmatch.features.config import FeatureConfig
from magmatch.features.infer import grid_spacing
from magmatch.field.build import build_map
from magmatch.field.config import SPLINE
from magmatch.grid import RegularGrid
from magmatch_evaluation.baselines.volume import (
    Volume,
    cut_layers,
    level_points,
    magnitude_volume,
    within_measurements,
)


def volume_of(function, T_map_grid=None, shape=(21, 17, 13), spacing=0.1):
    grid = RegularGrid(T_map_grid if T_map_grid is not None else RigidTransform.identity(), spacing, shape)
    points = grid.points()
    return Volume(grid, function(points).reshape(shape), np.ones(shape, dtype=bool), points)


def slope(p):
    return 5.0 + p @ np.array([1.0, -2.0, 0.5])


@settings(max_examples=15)
@given(st.integers(0, 10_000))
def test_layers_show_the_magnitude_where_their_pixels_lie(seed):
    rng = np.random.default_rng(seed)
    normal = rng.standard_normal(3)
    frame = RigidTransform.from_components(rng.standard_normal(3), Rotation.random(rng=rng))
    layers = cut_layers(volume_of(slope, frame), normal / np.linalg.norm(normal), 0.15, 20)
    assert len(layers) > 3
    for layer in layers:
        rows, columns = np.nonzero(layer.is_known)
        p = layer.points(np.column_stack([columns, rows]))
        inside = np.all(np.abs((frame.inv().apply(p) - [1.0, 0.8, 0.6]) / [1.0, 0.8, 0.6]) <= 1, axis=1)
        # Interpolation of a linear function is exact, short of the rim where there is nothing to interpolate.
        np.testing.assert_allclose(layer.magnitude[rows, columns][inside], slope(p)[inside], atol=1e-9)


def test_layers_across_z_lie_at_equal_heights():
    heights = [
        layer.T_map_image.translation[2] for layer in cut_layers(volume_of(slope), np.array([0, 0, 1.0]), 0.3, 9)
    ]
    np.testing.assert_allclose(np.diff(heights), 0.3)
    np.testing.assert_allclose(np.mean(heights), 0.6)


def test_survey_of_a_plane_gives_one_layer():
    assert len(cut_layers(volume_of(slope, shape=(9, 9, 1)), np.array([0, 0, 1.0]), 0.1, 9)) == 1


def test_surface_of_a_level_holds_points_of_that_level():
    volume = volume_of(slope, RigidTransform.from_rotation(Rotation.from_euler("xyz", [0.3, 0.2, 0.1])))
    points = level_points(volume, 4.7)
    assert len(points) > 50
    np.testing.assert_allclose(slope(points), 4.7, atol=1e-9)


def test_surface_stays_within_what_is_known():
    volume = volume_of(slope)
    volume.is_known[:, :9] = False
    assert level_points(volume, 4.0)[:, 1].min() == pytest.approx(0.9)
    assert not len(level_points(volume, 1e3))


@pytest.mark.parametrize("shape", [(3.0, 3.0, 1.0), (3.0, 3.0, 0.0)])
def test_what_lies_off_the_measurements_is_not_known(shape):
    rng = np.random.default_rng(1)
    p = rng.uniform(-0.5, 0.5, (300, 3)) * shape
    field_map = build_map(
        Survey(p, 1e-5 * np.column_stack([np.sin(2 * p[:, 1]), np.cos(2 * p[:, 0]), 4 + p[:, 2]])), SPLINE
    )
    given = magnitude_volume(field_map, 0.1)
    volume = within_measurements(given, field_map)
    spacing = grid_spacing(field_map, FeatureConfig())
    beyond = np.abs(volume.grid.points()) - np.array(shape) / 2
    known = volume.is_known.ravel()
    assert known.any()
    assert beyond[known].max() <= spacing / 2 + 1e-9
    assert not (volume.is_known & ~given.is_known).any()
