# SPDX-License-Identifier: BSD-3-Clause
"""The steps of the global search: who votes, on what, judged by which samples, and which poses are one."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.transform import RigidTransform, Rotation

from hand_made import box, prepared_map, seen_from, some_field, turn_about
from magmatch.estimation.pose_prior import PosePrior
from magmatch.geometry import random_transform
from magmatch.registration.search.invariant_search import (
    choose_anchors,
    distinct_poses,
    invariant_search,
    judging_samples,
    similar_points,
)

RNG = np.random.default_rng(0)
FIELD = some_field(3, slope=6e-6, bend=12e-6)
FLAT = PosePrior(10.0)
T_TRUE = random_transform(np.random.default_rng(4))


@pytest.fixture(scope="module")
def pair():
    """The target is the base, seen from elsewhere."""
    base = prepared_map(FIELD, box(RNG, 200), spacing=0.08)
    return base, seen_from(base, T_TRUE.inv(), spacing=0.08)


def test_a_point_is_most_like_itself_seen_from_elsewhere(pair):
    found = similar_points(*pair, np.arange(0, 200, 3), 4)
    assert found.shape == (67, 4)
    assert (found[:, 0] == np.arange(0, 200, 3)).all()
    assert similar_points(*pair, np.arange(5), 999).shape == (5, 200)


def test_anchors_are_drawn_once_each_by_how_well_their_gradient_is_known(pair):
    target = replace(pair[1], gradient_sd=np.where(np.arange(200) < 100, 1e-9, 1e-3))
    drawn = np.concatenate([choose_anchors(target, 60, np.random.default_rng(k)) for k in range(5)])
    assert (drawn < 100).mean() > 0.97
    once = choose_anchors(target, 60, np.random.default_rng(0))
    assert len(set(once.tolist())) == 60
    assert len(choose_anchors(target, 999, np.random.default_rng(0))) == 200
    # Far beyond the median a gradient is told no better.
    steep = replace(
        target,
        gradient_sd=np.zeros(200),
        point_gradient=target.point_gradient * np.where(np.arange(200) < 10, 1e3, 1)[:, None, None],
    )
    drawn = np.concatenate([choose_anchors(steep, 20, np.random.default_rng(k)) for k in range(30)])
    assert 0.05 < (drawn < 10).mean() < 0.25
    # Where the field has no gradient at all, one point is as good as another.
    even = replace(target, gradient_sd=np.zeros(200), point_gradient=np.zeros((200, 3, 3)))
    assert len(set(choose_anchors(even, 60, np.random.default_rng(0)).tolist())) == 60


def test_half_of_the_judges_are_near_the_anchor_and_the_others_anywhere(pair):
    target = replace(pair[1], correlation_length=0.25)
    anchors = target.points[:20]
    rows = judging_samples(anchors, target, 40, np.random.default_rng(0))
    assert rows.shape == (20, 40)
    apart = np.linalg.norm(target.samples[rows] - anchors[:, None], axis=2)
    n_near = (np.linalg.norm(target.samples - anchors[:, None], axis=2) < 0.5).sum(axis=1)
    for row, distance, n in zip(rows, apart, n_near, strict=True):
        first = min(20, n)
        assert (distance[:first] < 0.5).all()
        assert len(set(row[:first].tolist())) == first
    assert (apart[:, 20:] > 0.5).mean() > 0.5


def poses_of(turns, shifts):
    R = Rotation.from_rotvec(np.array(turns)[:, None] * [0, 0, 1.0]).as_matrix()
    return R, np.array(shifts)[:, None] * [1.0, 0, 0]


def test_distinct_poses_come_best_first_and_as_many_as_wanted():
    R, centers = poses_of(np.zeros(6), [0.0, 1, 2, 0.1, 3, 1.1])
    scores = np.array([1.0, 5, 3, 2, 4, 6])
    assert distinct_poses(R, centers, scores, 0.1, 0.5, 9).tolist() == [5, 4, 2, 3]
    assert distinct_poses(R, centers, scores, 0.1, 0.5, 2).tolist() == [5, 4]


def test_the_search_finds_the_turn_between_and_counts_what_it_tried(pair):
    found = invariant_search(*pair, FLAT, np.random.default_rng(0))
    np.testing.assert_allclose(found.poses[0].as_matrix(), T_TRUE.as_matrix(), atol=0.02)
    assert (found.n_keypoints, found.n_correspondences) == (400, 200 * 30)
    center = pair[1].samples.mean(axis=0)
    for k, T in enumerate(found.poses):
        for S in found.poses[:k]:
            angle = (T.rotation.inv() * S.rotation).magnitude()
            # Both inaccuracies together: of 0.1 rad and of 0.2 correlation lengths of 0.6 m.
            assert angle > 0.199 or np.linalg.norm(T.apply(center) - S.apply(center)) > 0.239


def test_what_a_prior_rules_out_is_not_handed_on(pair):
    center = pair[1].samples.mean(axis=0)
    sd = np.repeat([0.05, 0.1], 3)
    near = PosePrior(10.0, T_TRUE * turn_about(center, np.full(6, 0.05)), np.diag(sd**2))
    assert invariant_search(*pair, near, np.random.default_rng(0)).poses
    away = PosePrior(10.0, RigidTransform.from_translation([0, 0, 50.0]) * T_TRUE, np.diag(sd**2))
    for T in invariant_search(*pair, away, np.random.default_rng(0)).poses:
        assert np.linalg.norm(T.apply(center) - away.T_base_target.apply(center)) < 3.5 * 3
