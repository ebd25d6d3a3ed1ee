# SPDX-License-Identifier: BSD-3-Clause
"""Vector MSAC."""

import numpy as np
import pytest
from scipy.spatial.transform import RigidTransform, Rotation

from magmatch.geometry import random_transform, rotate_vectors, transform_error, transform_points
from magmatch.published.consensus import ConsensusConfig, vector_msac

CONFIG = ConsensusConfig()
DISTANCE = 0.2  # m
CENTER = np.array([1.5, 1.5, 0.5])


def correspondences(seed, T, n=200, outlier_share=0.0, point_sd=0.0, angle_sd=0.0):
    """Points and vectors of the target, where T puts them, and which pairs are right."""
    rng = np.random.default_rng(seed)
    p_target, b_target = rng.uniform(0, [3, 3, 1], (n, 3)), 5e-5 * rng.normal(size=(n, 3))
    p_base = transform_points(p_target, T) + point_sd * rng.normal(size=(n, 3))
    b_base = Rotation.from_rotvec(angle_sd * rng.normal(size=(n, 3))).apply(rotate_vectors(b_target, T))
    is_right = np.arange(n) >= outlier_share * n
    wrong = np.flatnonzero(~is_right)
    p_base[wrong] = transform_points(rng.uniform(0, [3, 3, 1], (len(wrong), 3)), T)
    b_base[wrong] = 5e-5 * rng.normal(size=(len(wrong), 3))
    return (p_base, p_target, b_base, b_target), is_right


def find(pairs, config=CONFIG, seed=0):
    return vector_msac(*pairs, DISTANCE, config, np.random.default_rng(seed))


@pytest.mark.parametrize("n", [3, 4, 60])
def test_the_stated_pose_is_the_least_squares_fit_of_its_inliers(n):
    T = random_transform(np.random.default_rng(n))
    pairs, _ = correspondences(n, T, n, point_sd=0.02, angle_sd=0.05)
    best = find(pairs, CONFIG.model_copy(update={"min_inliers": 3, "sample_size": 2}))[0]
    p_base, p_target, b_base, b_target = (part[best.is_inlier] for part in pairs)
    assert len(p_base) >= 3
    u, v = (b / np.linalg.norm(b, axis=1, keepdims=True) for b in (b_base, b_target))
    x, y = ((p - p.mean(axis=0)) / DISTANCE for p in (p_base, p_target))
    weights = np.repeat([1.0, CONFIG.vector_weight**2], len(p_base))
    turn = Rotation.align_vectors(np.concatenate([x, u]), np.concatenate([y, v]), weights)[0]
    assert (turn.inv() * best.T_base_target.rotation).magnitude() < 1e-9
    np.testing.assert_allclose(best.T_base_target.apply(p_target).mean(axis=0), p_base.mean(axis=0), atol=1e-9)


@pytest.mark.parametrize(("outlier_share", "sample_size"), [(0.5, 3), (0.95, 2), (0.95, 3)])
def test_the_transform_is_found_among_outliers(outlier_share, sample_size):
    T = random_transform(np.random.default_rng(4))
    pairs, is_right = correspondences(4, T, 500, outlier_share, point_sd=0.03, angle_sd=0.03)
    best = find(pairs, CONFIG.model_copy(update={"sample_size": sample_size}))[0]
    distance, angle = transform_error(best.T_base_target, T, CENTER)
    # Twenty-five right pairs of 3 cm leave 6 mm per axis.
    assert distance < 0.03
    assert angle < 0.02
    assert best.is_inlier[is_right].mean() > 0.95
    assert best.is_inlier[~is_right].mean() < 0.05


def test_vectors_tell_apart_what_points_cannot():
    # A square of points is its own image under a half turn; its vectors are not.
    corners = np.array([[0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0]], dtype=float)
    half_turn = Rotation.from_euler("z", 180, degrees=True)
    p_target = np.concatenate([corners, corners])
    p_base = np.concatenate([corners, RigidTransform.from_components([1, 1, 0], half_turn).apply(corners)])
    b = np.tile(5e-5 * np.array([[1.0, 0, 0.2], [1, 0, 0.3], [1, 0.1, 0], [1, 0, 0]]), (2, 1))
    config = CONFIG.model_copy(update={"min_inliers": 4})
    best = find((p_base, p_target, b, b), config)[0]
    assert best.T_base_target.rotation.magnitude() < 1e-6
    assert best.is_inlier.tolist() == [True] * 4 + [False] * 4
    blind = find((p_base, p_target, b, b), config.model_copy(update={"vector_weight": 0.0}))
    assert abs(blind[0].cost - blind[1].cost) < 1e-9


def test_opposed_vectors_are_no_inliers():
    T = random_transform(np.random.default_rng(2))
    (p_base, p_target, b_base, b_target), _ = correspondences(2, T, 50)
    flipped = np.where(np.arange(50)[:, None] < 10, -b_base, b_base)
    best = find((p_base, p_target, flipped, b_target))[0]
    assert best.is_inlier.tolist() == [False] * 10 + [True] * 40


def test_the_answer_moves_with_both_frames():
    rng = np.random.default_rng(8)
    T, T_new_base, T_new_target = (random_transform(rng) for _ in range(3))
    pairs, _ = correspondences(3, T, 300, 0.6, point_sd=0.03, angle_sd=0.03)
    moved = (
        transform_points(pairs[0], T_new_base),
        transform_points(pairs[1], T_new_target),
        rotate_vectors(pairs[2], T_new_base),
        rotate_vectors(pairs[3], T_new_target),
    )
    expected = T_new_base * find(pairs)[0].T_base_target * T_new_target.inv()
    distance, angle = transform_error(find(moved)[0].T_base_target, expected, T_new_target.apply(CENTER))
    assert distance < 1e-9
    assert angle < 1e-9


def test_no_two_candidates_are_one_answer_however_far_the_target_lies_from_its_origin():
    T = random_transform(np.random.default_rng(8))
    (p_base, p_target, b_base, b_target), _ = correspondences(
        8, T, 60, outlier_share=0.3, point_sd=0.06, angle_sd=0.06
    )
    away = np.array([20.0, -30.0, 10.0])
    found = find((p_base, p_target + away, b_base, b_target), CONFIG.model_copy(update={"min_inliers": 3}))
    assert len(found) > 1
    center = p_target.mean(axis=0) + away
    for k, one in enumerate(found):
        for other in found[:k]:
            distance, angle = transform_error(one.T_base_target, other.T_base_target, center)
            assert distance > DISTANCE or angle > 0.1


def test_too_few_or_coinciding_correspondences_give_nothing():
    for n in (0, 1, 5):
        assert find(correspondences(0, RigidTransform.identity(), n)[0]) == []
    point, vector = np.ones((50, 3)), 5e-5 * np.ones((50, 3))
    assert find((point, point, vector, vector)) == []
