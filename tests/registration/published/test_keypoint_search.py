# SPDX-License-Identifier: BSD-3-Clause
"""The published search as a whole, on maps made from samples."""

import numpy as np
import pytest
from scipy.spatial.transform import RigidTransform

from magmatch.data.survey import Survey
from magmatch.features.config import FeatureConfig
from magmatch.features.grids import grid_spacing
from magmatch.field.build import build_map
from magmatch.field.config import FieldConfig
from magmatch.geometry import random_transform, rotate_vectors, transform_error, transform_points
from magmatch.registration.decide.fitness import alignment_fitness
from magmatch.registration.published.config import PublishedConfig
from magmatch.registration.published.method import comparable, keypoint_search

CONFIG = PublishedConfig()
T_BASE_TARGET = random_transform(np.random.default_rng(11))
FIELD = FieldConfig(prior="divergence_free", lengthscale=0.6, signal_sd=2e-5, noise_sd=0.6e-6, spacing=0.45)


def survey_of(source, seed, T_world_survey, n=700):
    rng = np.random.default_rng(seed)
    x = rng.uniform(0, [3, 3, 0.6], (n, 3))
    b = source(x) + 0.5e-6 * rng.standard_normal((n, 3))
    T = T_world_survey.inv()
    return Survey(transform_points(x, T), rotate_vectors(b, T))


def room(seed, n=40):
    rng = np.random.default_rng(seed)
    p = rng.uniform([-1, -1, -1], [4, 4, 1.6], (40 * n, 3))
    p = p[np.linalg.norm(p - np.clip(p, 0, [3, 3, 0.6]), axis=1) > 0.35][:n]
    m = 3e-6 * rng.normal(size=(n, 3))

    def field(x):
        r = x[:, None] - p
        d = np.linalg.norm(r, axis=2)[..., None]
        total = (3 * (r * m).sum(axis=2, keepdims=True) * r / d**5 - m / d**3).sum(axis=1)
        return total + np.array([18e-6, 3e-6, -45e-6])

    return field


@pytest.fixture(scope="module")
def base_map():
    return build_map(survey_of(room(2), 1, RigidTransform.identity()), FIELD)


@pytest.fixture(scope="module")
def target_map():
    return build_map(survey_of(room(2), 2, T_BASE_TARGET), FIELD)


def test_published_search_finds_a_random_transform(base_map, target_map):
    T = T_BASE_TARGET
    found = keypoint_search(base_map, target_map, CONFIG, np.random.default_rng(0))
    best = found.poses[0]
    distance, angle = transform_error(best, T, target_map.survey.centroid)
    assert distance < 0.06
    assert np.degrees(angle) < 2
    assert alignment_fitness(base_map, target_map.survey, best).value < 0.05
    assert 50 < found.n_inliers == len(found.links.base) <= found.n_correspondences < found.n_keypoints
    assert np.all(np.linalg.norm(best.apply(found.links.target) - found.links.base, axis=1) < 0.3)


def test_different_rooms_share_little(base_map):
    other = build_map(survey_of(room(77), 3, RigidTransform.identity()), FIELD)
    found = keypoint_search(base_map, other, CONFIG, np.random.default_rng(0))
    worst = [alignment_fitness(base_map, other.survey, T) for T in found.poses]
    assert all(f.value > 0.1 or f.overlap < 0.3 for f in worst)


def test_nothing_in_common_is_a_result(base_map):
    nothing = CONFIG.model_copy(update={"features": FeatureConfig(min_frame_strength=0.999)})
    found = keypoint_search(base_map, base_map, nothing, np.random.default_rng(0))
    assert found.poses == ()
    assert found.n_inliers == found.n_correspondences == len(found.links.base) == 0


def test_both_maps_are_asked_at_one_spacing(base_map):
    finer = build_map(survey_of(room(2), 4, RigidTransform.identity()), FIELD.model_copy(update={"lengthscale": 0.4}))
    shared = comparable(base_map, finer, FeatureConfig())
    assert shared.spacing == grid_spacing(base_map, FeatureConfig()) > grid_spacing(finer, FeatureConfig())
    assert comparable(finer, base_map, FeatureConfig()) == shared


def test_the_same_seed_gives_the_same_bits(base_map, target_map):
    one, other = (keypoint_search(base_map, target_map, CONFIG, np.random.default_rng(5)) for _ in range(2))
    assert np.array_equal(one.poses[0].as_matrix(), other.poses[0].as_matrix())
