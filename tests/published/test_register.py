# SPDX-License-Identifier: BSD-3-Clause
"""The published method as a whole, on maps made from samples, and with parts of one's own."""

import numpy as np
import pytest
from scipy.spatial.transform import RigidTransform

from exact_maps import room_of_dipoles, survey_in
from magmatch.features.config import FeatureConfig
from magmatch.features.infer import grid_spacing
from magmatch.field.build import build_map
from magmatch.field.config import FieldConfig
from magmatch.geometry import random_transform, transform_error
from magmatch.published import Matches, PublishedConfig, register
from magmatch.published.register import comparable
from magmatch.registration.config import PRESETS

CONFIG = PublishedConfig()
BOX = np.array([3.0, 3.0, 0.6])
T_BASE_TARGET = random_transform(np.random.default_rng(11))
FIELD = FieldConfig(prior="divergence_free", lengthscale=0.6, signal_sd=2e-5, noise_sd=0.6e-6, spacing=0.45)


def survey_of(room, seed, T_world_survey, n=700):
    rng = np.random.default_rng(seed)
    x = rng.uniform(0, BOX, (n, 3))
    noise = 0.5e-6 * rng.standard_normal((n, 3))
    return survey_in(room_of_dipoles(room, BOX), x, T_world_survey, noise)


@pytest.fixture(scope="module")
def base_map():
    return build_map(survey_of(2, 1, RigidTransform.identity()), FIELD)


@pytest.fixture(scope="module")
def target_map():
    return build_map(survey_of(2, 2, T_BASE_TARGET), FIELD)


def test_the_published_method_finds_a_random_transform(base_map, target_map):
    T = T_BASE_TARGET
    found = register(base_map, target_map)
    assert found.is_accepted
    distance, angle = transform_error(found.T_base_target, T, target_map.survey.centroid)
    assert distance < 0.06
    assert np.degrees(angle) < 2
    assert found.check.value < 0.05
    n_keypoints = len(found.base) + len(found.target)
    assert 50 < found.inliers.sum() <= len(found.matches) < n_keypoints
    p_base = found.base.positions[found.matches.base_rows[found.inliers]]
    p_target = found.target.positions[found.matches.target_rows[found.inliers]]
    assert np.all(np.linalg.norm(found.T_base_target.apply(p_target) - p_base, axis=1) < 0.3)
    assert len(repr(found).splitlines()) <= 3


def test_to_the_letter_the_method_finds_it_too(base_map, target_map):
    found = register(base_map, target_map, config=PRESETS["paper-literal"].keypoints)
    assert found.is_accepted
    distance, angle = transform_error(found.T_base_target, T_BASE_TARGET, target_map.survey.centroid)
    assert distance < 0.06
    assert np.degrees(angle) < 3
    assert found.config.features.component_range == 0.01


def test_nothing_in_common_is_a_result(base_map):
    nothing = CONFIG.model_copy(update={"features": FeatureConfig(min_frame_strength=0.999)})
    found = register(base_map, base_map, config=nothing)
    assert found.candidates == ()
    assert found.check is found.T_base_target is None
    assert len(found.inliers) == len(found.matches) == 0


def test_both_maps_are_asked_at_one_spacing_and_over_one_range(base_map):
    finer = build_map(survey_of(2, 4, RigidTransform.identity()), FIELD.model_copy(update={"lengthscale": 0.4}))
    shared = comparable(base_map, finer, CONFIG)
    assert shared.features.spacing == grid_spacing(base_map, FeatureConfig()) > grid_spacing(finer, FeatureConfig())
    assert comparable(finer, base_map, CONFIG) == shared


def test_a_detector_a_descriptor_and_a_matcher_of_ones_own_are_used(base_map, target_map):
    """Every fifth point is a keypoint, known by the strength of its field; all match the first one of the base."""

    def detector(inferred):
        return np.arange(0, len(inferred), 5)

    def descriptor(inferred, frames):
        return np.linalg.norm(inferred.field[frames.rows], axis=1)[:, None]

    def matcher(base, target):
        assert base.shape[1] == target.shape[1] == 1
        rows = np.arange(len(target))
        return Matches(0 * rows, rows, np.zeros(len(rows)))

    found = register(base_map, target_map, detector=detector, descriptor=descriptor, matcher=matcher)
    assert len(found.target) == len(found.matches)
    np.testing.assert_allclose(found.base.descriptors[:, 0], np.linalg.norm(found.base.field, axis=1))
    assert not found.candidates
