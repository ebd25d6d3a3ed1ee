# SPDX-License-Identifier: BSD-3-Clause
"""Pairs of points that find a walk: which are tabulated and drawn, what resembles what, and the poses that follow."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.distance import pdist

from hand_made import box, prepared_map, some_field
from magmatch.estimation.candidate_poses import CandidatePoses
from magmatch.estimation.limits import N_CANDIDATES
from magmatch.estimation.pose_prior import PosePrior
from magmatch.estimation.walk import Walk
from magmatch.geometry import random_transform, rotation_matrix
from magmatch.registration.search.pair_search import (
    choose_pairs,
    invariants_of,
    pair_poses,
    pair_search,
    tabulate_pairs,
    weigh_bins,
)
from magmatch.registration.search.scoring import score_poses

LENGTH = 0.5
T_TRUE = random_transform(np.random.default_rng(1))


@pytest.fixture(scope="module")
def base():
    return prepared_map(
        some_field(3, slope=8e-6, bend=8e-6), box(np.random.default_rng(0), 150), spacing=0.08, length=LENGTH
    )


@pytest.fixture(scope="module")
def table(base):
    return tabulate_pairs(base, 0.3e-6)


@pytest.fixture(scope="module")
def walk(base):
    """Through points of the base itself, seen from elsewhere."""
    rows = np.argsort(base.samples[:, 0])[5:145:7]
    there = T_TRUE.inv()
    return Walk(T_TRUE, there.apply(base.samples[rows]), there.rotation.apply(base.point_field[rows]))


def test_the_table_holds_each_pair_of_a_length_within_bounds_in_both_orders(table):
    a, b = table.first, table.second
    d = np.linalg.norm(table.positions[a] - table.positions[b], axis=1)
    assert d.min() > 0.8 * LENGTH
    assert d.max() <= 6.2 * LENGTH
    assert {*zip(a.tolist(), b.tolist(), strict=True)} == {*zip(b.tolist(), a.tolist(), strict=True)}
    every = pdist(table.positions)
    assert len(a) == 2 * ((every > 0.8 * LENGTH) & (every <= 6.2 * LENGTH)).sum()


def test_a_point_is_as_uncertain_as_another_walk_passes_it(base, table):
    G = base.point_gradient
    assert table.sd_position == pytest.approx(0.125 * LENGTH)
    assert table.gradient_rms == pytest.approx(np.sqrt((G**2).mean()))
    moved = table.sd_position * np.random.default_rng(2).standard_normal((20_000, 3))
    change = np.einsum("nij,nj->ni", G[np.arange(20_000) % len(G)], moved)
    np.testing.assert_allclose(table.sd_field**2, (change**2).mean() + 0.3e-6**2, rtol=0.05)
    assert table.field_norm == pytest.approx(np.median(np.linalg.norm(base.point_field, axis=1)))


def test_long_pairs_whose_fields_differ_are_drawn_more_often_and_each_once(walk, table):
    drawn = [choose_pairs(walk, table, 60, np.random.default_rng(k)) for k in range(10)]
    for i, j in drawn:
        assert len({*zip(i.tolist(), j.tolist(), strict=True)}) == len(i) == 60
        d = np.linalg.norm(walk.positions[i] - walk.positions[j], axis=1)
        assert d.min() > 0.8 * LENGTH
        assert d.max() < 6.2 * LENGTH - table.sd_position
    i, j = np.concatenate(drawn, axis=1)
    every = np.triu_indices(len(walk), 1)

    def share(i, j):
        change = np.linalg.norm(walk.field[i] - walk.field[j], axis=1)
        return (np.linalg.norm(walk.positions[i] - walk.positions[j], axis=1) * (table.sd_field + change)).mean()

    assert share(i, j) > 1.1 * share(*every)
    near = Walk(walk.T_survey_walk, 0.1 * walk.positions, walk.field)
    assert len(choose_pairs(near, table, 60, np.random.default_rng(0))[0]) == 0


def test_a_pair_seen_from_elsewhere_is_most_like_itself_and_gives_the_pose_between(walk, table):
    i, j = choose_pairs(walk, table, 60, np.random.default_rng(0))
    similar, distance2 = table.nearest(invariants_of(walk, i, j), 3)
    assert (np.diff(distance2, axis=1) >= 0).all()
    is_there = distance2[:, 0] < 1e-6
    assert is_there.mean() > 0.2
    R, pb, rows, _ = pair_poses(table, walk, i, j, similar)
    assert rows.tolist() == np.repeat(np.arange(len(i)), 3).tolist()
    first = np.arange(len(i)) * 3
    true = R[first[is_there]]
    np.testing.assert_allclose(true, np.tile(rotation_matrix(T_TRUE), (len(true), 1, 1)), atol=1e-4)
    middle = T_TRUE.apply((walk.positions[i] + walk.positions[j]) / 2)
    np.testing.assert_allclose(pb[first[is_there]], middle[is_there], atol=1e-9)


def test_a_walk_that_is_explained_exactly_says_more_the_less_noise_the_base_has(base, walk, table):
    center = walk.positions.mean(axis=0)
    true = CandidatePoses(rotation_matrix(T_TRUE)[None], T_TRUE.apply(center)[None], np.zeros(1, int), center[None])
    scores = []
    for noise_sd in (0.1e-6, 1e-6, 10e-6):
        evidence = weigh_bins(replace(base, noise_sd=noise_sd), table, walk)
        score = score_poses(true, np.arange(len(walk))[None], evidence, base, 0.025, 0.025, 0.3)
        scores.append(float(score[0]) / len(walk))
    assert scores[0] > scores[1] + 0.1 > scores[2] + 0.2


def test_the_search_finds_the_pose_between_and_keeps_distinct_poses_best_first(base, walk, table):
    found = pair_search(base, table, walk, PosePrior(10.0), np.random.default_rng(0))
    np.testing.assert_allclose(found.poses[0].as_matrix(), T_TRUE.as_matrix(), atol=0.03)
    assert len(found.poses) <= N_CANDIDATES
    assert found.n_keypoints == len(table.positions) + len(walk)
    assert found.n_correspondences == 60 * 8
    center = walk.positions.mean(axis=0)
    for k, T in enumerate(found.poses):
        for S in found.poses[:k]:
            angle = (T.rotation.inv() * S.rotation).magnitude()
            assert angle > 0.099 or np.linalg.norm(T.apply(center) - S.apply(center)) > 0.299 * LENGTH
