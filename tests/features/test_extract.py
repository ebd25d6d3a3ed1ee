# SPDX-License-Identifier: BSD-3-Clause
"""Laws of the whole extraction: keypoints move with the map, descriptors stay."""

import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st

from magmatch.features.config import FeatureConfig
from magmatch.features.descriptors import N_DIMENSIONS, component_range
from magmatch.features.extract import extract_features
from magmatch.geometry import random_transform

LAW = settings(max_examples=8, deadline=None)
# Along principal axes, so that the grid turns with the survey.
CONFIG = FeatureConfig(spacing=0.15, axes="principal")


def assert_carried(moved, features, T):
    expected = features.transformed(T)
    assert len(moved) == len(features) > 0
    np.testing.assert_allclose(moved.positions, expected.positions, rtol=0, atol=1e-9)
    np.testing.assert_allclose(moved.field, expected.field, rtol=0, atol=1e-9 * np.abs(features.field).max())
    assert np.all((moved.local_frames * expected.local_frames.inv()).magnitude() < 1e-9)
    # A hard histogram moves a whole count where a vector lies within rounding of a bin's edge: with some 1e5 vectors
    # in 90 bins at random that is a chance of about 1e-6 per example, so none may differ here.
    np.testing.assert_allclose(moved.descriptors, features.descriptors, rtol=0, atol=1e-9)


@given(seed=st.integers(0, 1000))
@LAW
def test_features_move_with_a_survey_that_was_taken_in_another_frame(make_map, seed):
    T_new_world = random_transform(np.random.default_rng(seed))
    features = extract_features(make_map(seed), CONFIG)
    assert_carried(extract_features(make_map(seed, T_new_world.inv()), CONFIG), features, T_new_world)


def test_descriptors_of_two_surveys_of_one_room_look_alike(make_map):
    config = FeatureConfig(spacing=0.1)
    one, other = make_map(0), make_map(0, sample_seed=99)
    half_range = max(component_range(m.survey.field) for m in (one, other))
    a, b = extract_features(one, config, half_range), extract_features(other, config, half_range)
    alike = np.linalg.norm(a.descriptors[:, None] - b.descriptors, axis=2).argmin(axis=1)
    apart = np.linalg.norm(a.positions - b.positions[alike], axis=1)
    anywhere = np.linalg.norm(a.positions[:, None] - b.positions, axis=2)
    assert np.median(apart) < 0.1
    assert np.median(anywhere) > 4 * np.median(apart)


def test_a_uniform_field_gives_no_features(make_map, make_room):
    features = extract_features(make_map(0, source=make_room(0, n=0)), CONFIG)
    assert len(features) == 0
    assert features.descriptors.shape == (0, N_DIMENSIONS)
