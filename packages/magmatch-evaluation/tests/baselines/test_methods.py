# SPDX-License-Identifier: BSD-3-Clause
"""Each baseline finds a map again that was only carried to another frame, and refuses where nothing matches."""

import numpy as np
import pytest
from scipy.spatial.transform import RigidTransform, Rotation

from magmatch.features.config import FeatureConfig
from magmatch.geometry import transform_error
from magmatch.registration.config import PRESETS
from magmatch.registration.result import Status
from magmatch_evaluation.baselines.hov_kiss import KissConfig, register_by_kiss_matcher
from magmatch_evaluation.baselines.judged import judged
from magmatch_evaluation.baselines.local_refinement import GicpConfig, register_by_gicp, register_by_refinement
from magmatch_evaluation.baselines.sift_layers import SiftConfig, icosahedron_axes, match_elsewhere, register_by_sift

LEVEL = RigidTransform.from_components([0.4, -0.2, 0.3], Rotation.from_euler("z", 25, degrees=True))
ASKEW = RigidTransform.from_components([0.4, -0.2, 0.3], Rotation.from_rotvec([0.5, -0.9, 0.7]))
NEAR = RigidTransform.from_components([0.08, -0.05, 0.05], Rotation.from_rotvec([0.05, -0.07, 0.06]))


def assert_found(result, T_base_target, center, max_m, max_deg):
    assert result.is_accepted, result.reason
    distance, angle = transform_error(result.T_base_target, T_base_target, center)
    assert (distance, np.degrees(angle)) < (max_m, 90)
    assert np.degrees(angle) < max_deg


def test_sift_on_level_layers_finds_a_turn_about_the_vertical(room):
    target = room.transformed(LEVEL.inv())
    assert_found(register_by_sift(room, target, SiftConfig(), 0), LEVEL, target.survey.centroid, 0.05, 3)


def test_sift_in_many_directions_finds_any_turn(room):
    target = room.transformed(ASKEW.inv())
    config = SiftConfig(directions="many", pixels_per_lengthscale=12, layer_gap=4.0, max_layers=6)
    assert_found(register_by_sift(room, target, config, 0), ASKEW, target.survey.centroid, 0.1, 6)


def test_kiss_matcher_finds_any_turn(room):
    pytest.importorskip("kiss_matcher")
    coarse = KissConfig(features=FeatureConfig(max_points=8000))
    target = room.transformed(ASKEW.inv())
    assert_found(register_by_kiss_matcher(room, target, coarse, 0), ASKEW, target.survey.centroid, 0.15, 8)


def test_gicp_ends_a_rough_start(room):
    target = room.transformed(ASKEW.inv())
    assert_found(
        register_by_gicp(room, target, ASKEW * NEAR, GicpConfig(), 0), ASKEW, target.survey.centroid, 0.02, 1.5
    )


def test_refinement_alone_ends_a_rough_start(room):
    target = room.transformed(ASKEW.inv())
    result = register_by_refinement(room, target, ASKEW * NEAR, PRESETS["default"], 0)
    assert_found(result, ASKEW, target.survey.centroid, 1e-3, 0.05)


def test_pose_that_turns_the_field_over_is_refused_and_kept_as_candidate(room):
    over = RigidTransform.from_rotation(Rotation.from_euler("x", 180, degrees=True))
    result = judged(room, room, over)
    assert result.status is not Status.ACCEPTED
    np.testing.assert_array_equal(result.alternatives[0].T_base_target.as_matrix(), over.as_matrix())


@pytest.mark.parametrize("found", [None, "not finite"])
def test_no_pose_is_a_refusal(room, found):
    result = judged(room, room, found and RigidTransform.from_translation([np.nan, 0.0, 0.0]))
    assert result.status is Status.UNINFORMATIVE
    assert result.T_base_target is None
    assert not result.alternatives


def test_icosahedron_has_an_axis_within_21_degrees_of_any_direction():
    axes = icosahedron_axes()
    assert len(axes) == 31
    np.testing.assert_allclose(np.linalg.norm(axes, axis=1), 1)
    directions = np.random.default_rng(0).standard_normal((2000, 3))
    directions /= np.linalg.norm(directions, axis=1)[:, None]
    assert np.degrees(np.arccos(np.abs(directions @ axes.T).max(axis=1))).max() < 21


def test_same_blob_in_a_neighbouring_layer_is_no_rival():
    base = np.array([[0.0, 0.0], [0.1, 0.0], [5.0, 0.0]])
    here, elsewhere = np.array([[0, 0, 0], [0, 0, 0.1], [0, 0, 0.2]]), np.array([[0, 0, 0], [3, 0, 0], [0, 0, 0.2]])
    target = np.array([[0.0, 0.05]])
    rows = match_elsewhere(here.astype(float), base, target, 1.0, 0.5)
    assert [list(r) for r in rows] == [[0], [0]]
    rows = match_elsewhere(elsewhere.astype(float), base, target, 1.0, 0.4)
    assert [list(r) for r in rows] == [[], []]
