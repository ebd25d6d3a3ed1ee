# SPDX-License-Identifier: BSD-3-Clause
"""Where a map is asked, and what it says there."""

import numpy as np
import pytest

from magmatch.errors import ConfigurationError
from magmatch.features.config import FeatureConfig
from magmatch.features.infer import infer
from magmatch.geometry import in_hull, random_transform


def circle(n=300):
    angle = np.linspace(0, 2 * np.pi, n)
    return np.column_stack([1.2 + np.cos(angle), 1 + np.sin(angle), 0.3 + 0 * angle])


def test_a_volume_is_asked_everywhere_within_its_hull_and_a_path_only_nearby(make_map):
    config = FeatureConfig(spacing=0.1)
    field_map = make_map(0)
    region = infer(field_map, config)
    assert in_hull(region.positions, field_map.survey.positions).all()
    inside = in_hull(region.grid.points(), field_map.survey.positions)
    assert len(region) == inside.sum() > 0.55 * region.grid.n_points
    config = FeatureConfig(spacing=0.04)
    path = infer(make_map(0, x=circle()), config)
    assert len(path) < path.grid.n_points / 2
    distance = np.linalg.norm(path.positions[:, None] - circle(), axis=2).min(axis=1)
    # A sample's own cell is up to half a diagonal away from it.
    assert distance.max() < (config.path_radius + 0.9) * 0.04


def test_the_grid_follows_the_survey_and_the_normal_of_a_flat_one(make_map):
    T = random_transform(np.random.default_rng(3))
    axes = infer(make_map(0), FeatureConfig(spacing=0.2)).grid.T_map_grid.rotation
    assert axes.magnitude() < 1e-12
    rng = np.random.default_rng(1)
    flat = np.column_stack([rng.uniform(0, [2.4, 2.0], (400, 2)), rng.uniform(0.3, 0.32, 400)])
    inferred = infer(make_map(0, T, x=flat), FeatureConfig(spacing=0.1))
    assert min(inferred.grid.shape) == 1
    height = T.apply(inferred.positions)[:, 2]
    np.testing.assert_allclose(height, 0.31, atol=0.002)
    assert len(inferred) > 300


def test_a_stated_spacing_is_used_or_refused(make_map):
    field_map = make_map(0)
    assert infer(field_map, FeatureConfig(spacing=0.1234)).spacing == 0.1234
    with pytest.raises(ConfigurationError, match=r"spacing: 0\.01 m needs \d+ .* max_points = 40000"):
        infer(field_map, FeatureConfig(spacing=0.01))


def test_only_points_that_the_map_knows_are_asked(make_map):
    field_map = make_map(0, x=circle())
    assert field_map.knows(infer(field_map, FeatureConfig(spacing=0.1)).positions).all()


@pytest.mark.parametrize("kind", ["region", "path"])
def test_the_number_of_points_is_bounded(make_map, kind):
    config = FeatureConfig(spacing_in_lengthscales=0.02, max_points=2000, grid=kind)
    field_map = make_map(0)
    inferred = infer(field_map, config)
    assert 500 < len(inferred) <= 2000
    assert inferred.spacing > 0.05


@pytest.mark.parametrize("kind", ["region", "path"])
def test_support_is_what_lies_within_the_radius(make_map, kind):
    points = infer(make_map(0, x=circle()), FeatureConfig(spacing=0.15, grid=kind))
    rows = np.arange(0, len(points), 7)
    neighbours, distance = points.support(rows, 2.5)
    offset = points.positions[neighbours] - points.positions[rows][:, None]
    there = neighbours >= 0
    np.testing.assert_allclose(
        np.linalg.norm(offset, axis=2)[there] / 0.15, np.broadcast_to(distance, there.shape)[there]
    )
    apart = np.linalg.norm(points.positions[rows][:, None] - points.positions, axis=2) / 0.15
    assert np.array_equal(there.sum(axis=1), (apart < 2.5 + 1e-6).sum(axis=1) - 1)


def test_a_straight_oblique_line_holds_no_region(make_map):
    line = make_map(0, x=np.linspace(0, 2, 200)[:, None] * np.array([0.6, 0.8, 0.0]))
    assert len(infer(line, FeatureConfig(grid="region")).positions) == 0
    assert len(infer(line).positions) > 0
