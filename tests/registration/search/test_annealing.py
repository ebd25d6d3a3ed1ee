# SPDX-License-Identifier: BSD-3-Clause
"""Steps of the coarse refinement, where one linear step is exact or nearly so."""

from dataclasses import replace

import numpy as np
import pytest

from hand_made import box, prepared_map, some_field, turn_about
from magmatch.estimation.candidate_poses import CandidatePoses
from magmatch.geometry import rotation_matrix
from magmatch.registration.search.annealing import anneal_poses
from magmatch.registration.search.scoring import score_poses, weigh_samples

EPS = 1e-12  # no outliers: least squares
ANCHOR = np.array([0.1, -0.1, 0.05])


@pytest.fixture(scope="module")
def pair():
    rng = np.random.default_rng(1)
    field = some_field(3, bend=0.0)
    return (
        prepared_map(field, box(rng, 100, (2.6, 2.2, 1.4)), noise_sd=0.2e-6),
        prepared_map(field, box(rng, 60, (1.2, 1.0, 0.5)), noise_sd=0.2e-6),
    )


def annealed(pair, xi, schedule, damping=1e-9, eps=EPS):
    base, target = pair
    T = turn_about(ANCHOR, np.asarray(xi, float))
    rows = np.arange(len(target.samples))[None]
    poses = CandidatePoses(rotation_matrix(T)[None], T.apply(ANCHOR)[None], np.zeros(1, int), ANCHOR[None])
    found, scores = anneal_poses(poses, rows, weigh_samples(base, target), base, np.array(schedule), eps, damping)
    return found.rotations[0], found.anchors_base[0], scores[0]


def off(R, pb):
    return max(np.abs(R - np.eye(3)).max(), np.abs(pb - ANCHOR).max())


def test_steps_end_at_the_truth(pair):
    R, pb, _ = annealed(pair, [0.05, -0.04, 0.06, 0.03, 0.04, -0.03], [[0.05, 0.05]] * 8)
    assert off(R, pb) < 1e-9


def test_no_step_is_longer_than_three_times_what_is_granted(pair):
    R, pb, _ = annealed(pair, [0, 0, 0.4, 0, 0, 0], [[0.01, 10.0]])
    turn = np.arccos((np.trace(R) - 1) / 2)
    assert turn == pytest.approx(0.4 - 0.03, abs=1e-3)
    _, pb, _ = annealed(pair, [0, 0, 0, 0.5, 0, 0], [[10.0, 0.01]])
    assert np.linalg.norm(pb - ANCHOR - [0.5, 0, 0]) == pytest.approx(0.03, rel=1e-6)


def test_a_pose_is_scored_as_the_search_scores_it(pair):
    base, target = pair
    schedule = [[0.05, 0.04], [0.02, 0.03]]
    R, pb, found = annealed(pair, [0.1, 0, 0, 0, 0.1, 0], schedule, damping=0.3, eps=0.3)
    poses, rows = (
        CandidatePoses(R[None], pb[None], np.zeros(1, int), ANCHOR[None]),
        np.arange(len(target.samples))[None],
    )
    expected = score_poses(poses, rows, weigh_samples(base, target), base, *schedule[-1], 0.3)
    assert found == pytest.approx(expected[0], rel=1e-9)


def test_samples_that_match_nothing_hardly_pull(pair):
    base, target = pair
    field = target.sample_field.copy()
    field[::4] += [30e-6, -20e-6, 25e-6]
    disturbed = base, replace(target, sample_field=field)
    R, pb, _ = annealed(disturbed, [0.02, 0, -0.02, 0.02, 0.02, 0], [[0.02, 0.02]] * 12, eps=0.3)
    assert off(R, pb) < 1e-3
