# SPDX-License-Identifier: BSD-3-Clause
"""Where a map is asked."""

import numpy as np
import pytest

from magmatch.features.config import FeatureConfig
from magmatch.features.grids import evaluate_at, grid_spacing, inference_grid
from magmatch.field.cholesky.cells import ball_offsets


def circle(n=300):
    angle = np.linspace(0, 2 * np.pi, n)
    return np.column_stack([1.2 + np.cos(angle), 1 + np.sin(angle), 0.3 + 0 * angle])


def test_a_volume_is_asked_everywhere_and_a_path_only_nearby(make_map):
    config = FeatureConfig(spacing=0.1)
    region = inference_grid(make_map(0), config)
    assert len(region) == region.grid.n_points
    config = FeatureConfig(spacing=0.04)
    path = inference_grid(make_map(0, x=circle()), config)
    assert len(path) < path.grid.n_points / 2
    distance = np.linalg.norm(path.positions[:, None] - circle(), axis=2).min(axis=1)
    # A sample's own cell is up to half a diagonal away from it.
    assert distance.max() < (config.path_radius + 0.9) * 0.04


@pytest.mark.parametrize("kind", ["region", "path"])
def test_the_kind_of_grid_can_be_chosen(make_map, kind):
    field_map = make_map(0, x=circle())
    config = FeatureConfig(spacing=0.2, grid=kind)
    points = inference_grid(field_map, config)
    assert field_map.knows(points.positions).all()
    near = np.linalg.norm(points.positions[:, None] - circle(), axis=2).min(axis=1) < 0.8
    assert near.all() == (kind == "path")


def test_only_points_that_the_map_knows_are_asked(make_map):
    field_map = make_map(0, x=circle())
    assert field_map.knows(inference_grid(field_map, FeatureConfig(spacing=0.1)).positions).all()


@pytest.mark.parametrize("kind", ["auto", "region", "path"])
def test_the_number_of_points_is_bounded(make_map, kind):
    config = FeatureConfig(spacing=0.01, max_points=2000, grid=kind)
    field_map = make_map(0)
    assert 500 < len(inference_grid(field_map, config)) <= 2000
    assert grid_spacing(field_map, config) > 0.05


def test_spacing_follows_the_lengthscale(make_map):
    field_map = make_map(0)
    config = FeatureConfig(spacing_in_lengthscales=0.3)
    np.testing.assert_allclose(grid_spacing(field_map, config), 0.3 * field_map.hyperparameters.lengthscale)


@pytest.mark.parametrize("kind", ["region", "path"])
def test_support_is_what_lies_within_the_radius(make_map, kind):
    points = inference_grid(make_map(0, x=circle()), FeatureConfig(spacing=0.15, grid=kind))
    rows = np.arange(0, len(points), 7)
    neighbours, distance = points.support(rows, 2.5)
    offset = points.positions[neighbours] - points.positions[rows][:, None]
    there = neighbours >= 0
    np.testing.assert_allclose(
        np.linalg.norm(offset, axis=2)[there] / 0.15, np.broadcast_to(distance, there.shape)[there]
    )
    apart = np.linalg.norm(points.positions[rows][:, None] - points.positions, axis=2) / 0.15
    assert np.array_equal(there.sum(axis=1), (apart < 2.5 + 1e-6).sum(axis=1) - 1)


def test_four_spacings_hold_257_points():
    assert len(ball_offsets(4.0)) == 257


def test_values_are_those_at_the_points_whichever_way_they_are_asked(make_map):
    for x in (None, circle()):
        field_map = make_map(0, x=x)
        points = inference_grid(field_map, FeatureConfig(spacing=0.15))
        asked, direct = evaluate_at(field_map, points), field_map.evaluate(points.positions, 2)
        np.testing.assert_allclose(asked.field, direct.field, atol=1e-15)
        np.testing.assert_allclose(asked.second, direct.second, atol=1e-12)
