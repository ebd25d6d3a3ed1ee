# SPDX-License-Identifier: BSD-3-Clause
"""What a pose scores, against its formula in NumPy, and whatever frames the two surveys are in."""

import numpy as np
import pytest
from scipy.spatial.transform import RigidTransform, Rotation

from hand_made import box, prepared_map, seen_from, some_field, turn_about
from magmatch.estimation.candidate_poses import CandidatePoses
from magmatch.geometry import random_transform, rotation_matrix
from magmatch.registration.search.scoring import score_poses, weigh_samples

FIELD = some_field(3, bend=0.0)  # linear: what is interpolated is exact, in every frame
SD = 0.4e-6
AXES = [[0, 1, 0], [0, 0, 1], [1, 0, 0]]
SD_TURN, SD_SHIFT, EPS = 0.05, 0.04, 0.3


def pair_of(T_base_target=None, sd=SD):
    rng = np.random.default_rng(1)
    base = prepared_map(FIELD, box(rng, 200, (2.6, 2.2, 1.4)), rng, sd=sd, noise_sd=0.2e-6)
    target = prepared_map(FIELD, box(rng, 80, (1.2, 1.0, 0.5)), rng, noise_sd=0.3e-6)
    return base, target


def score(base, target, poses, anchors, rows=None):
    """Of poses that each turn about their own anchor."""
    R = np.stack([rotation_matrix(T) for T in poses])
    pb = np.stack([T.apply(a) for T, a in zip(poses, anchors, strict=True)])
    rows = np.tile(np.arange(len(target.samples)), (len(poses), 1)) if rows is None else rows
    tried = CandidatePoses(R, pb, np.arange(len(poses)), anchors)
    return score_poses(tried, rows, weigh_samples(base, target), base, SD_TURN, SD_SHIFT, EPS)


def some_poses(n=4, seed=2):
    rng = np.random.default_rng(seed)
    return [turn_about(np.zeros(3), np.append(0.1 * rng.normal(size=3), 0.1 * rng.normal(size=3))) for _ in range(n)]


def test_a_score_is_the_sum_of_the_logarithms_of_its_formula():
    base, target = pair_of()
    poses, anchors = some_poses(), target.samples[:4]
    e = weigh_samples(base, target)
    expected = []
    for T, anchor in zip(poses, anchors, strict=True):
        r = target.sample_field @ rotation_matrix(T).T - FIELD.evaluate(T.apply(target.samples)).field
        d2 = ((target.samples - anchor) ** 2).sum(axis=1)
        V = e.noise_variance + SD**2 + (e.field_rms * SD_TURN) ** 2
        V = np.minimum(V + e.gradient_rms**2 * (SD_SHIFT**2 + SD_TURN**2 * d2), e.deviation_variance)
        L = e.deviation2 / (2 * e.deviation_variance) - (r**2).sum(axis=1) / (2 * V)
        L = L + 1.5 * np.log(e.deviation_variance / V)
        expected.append(np.log(EPS + (1 - EPS) * np.exp(L)).sum())
    np.testing.assert_allclose(score(base, target, poses, anchors), expected, rtol=1e-9)


def test_scores_are_unchanged_when_either_frame_turns():
    base, target = pair_of()
    poses, anchors = some_poses(), target.samples[:4]
    here = score(base, target, poses, anchors)
    rng = np.random.default_rng(5)
    # The target's field is compared with its median of each component, which turns with its axes alone.
    A, B = random_transform(rng), RigidTransform.from_components(rng.normal(size=3), Rotation.from_matrix(AXES))
    there = seen_from(base, A, sd=SD), seen_from(target, B)
    moved = [A * T * B.inv() for T in poses]
    np.testing.assert_allclose(score(*there, moved, B.apply(anchors)), here, rtol=1e-6)
    assert np.ptp(here) > 10


def test_samples_outside_the_base_say_nothing():
    base, target = pair_of()
    away = RigidTransform.from_translation([50.0, 0.0, 0.0])
    assert score(base, target, [away], target.samples[:1]) == pytest.approx([0.0])
    half = RigidTransform.from_translation([base.samples[:, 0].max() + 0.3, 0.0, 0.0])
    is_inside = base.raster.lookup(half.apply(target.samples))[3]
    assert 0.2 < is_inside.mean() < 0.8
    rows = np.flatnonzero(is_inside)[None]
    some = score(base, target, [half], target.samples[:1], rows)
    np.testing.assert_allclose(score(base, target, [half], target.samples[:1]), some, rtol=1e-12)


def test_many_samples_overflow_no_product():
    base, target = pair_of(sd=0.0)
    rows = np.tile(np.arange(len(target.samples)), (2, 60))
    poses = [RigidTransform.identity(), turn_about(np.zeros(3), np.array([0, 0, 3.0, 0, 0, 0]))]
    whole = score(base, target, poses, target.samples[:2], rows)
    np.testing.assert_allclose(whole, 60 * score(base, target, poses, target.samples[:2]), rtol=1e-9)
    assert whole[0] > 1000
