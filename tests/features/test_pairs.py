# SPDX-License-Identifier: BSD-3-Clause
import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from magmatch.features.pairs import align_pairs, pair_invariants, whiten_pairs
from magmatch.geometry import random_transform, rotate_vectors, transform_points

LAW = settings(deadline=None, max_examples=25)
SEEDS = st.integers(0, 2**32 - 1)


def random_pairs(rng, n=20):
    x, y = rng.uniform(-5, 5, (2, n, 3))
    a, b = 40e-6 * rng.standard_normal((2, n, 3))
    return x, y, a, b


@LAW
@given(SEEDS)
def test_invariants_stay_when_the_survey_moves(seed):
    rng = np.random.default_rng(seed)
    x, y, a, b = random_pairs(rng)
    T = random_transform(rng)
    moved = (transform_points(x, T), transform_points(y, T), rotate_vectors(a, T), rotate_vectors(b, T))
    before, after = pair_invariants(x, y, a, b), pair_invariants(*moved)
    np.testing.assert_allclose(after[:, 0], before[:, 0], rtol=1e-9)
    np.testing.assert_allclose(after[:, 1:], before[:, 1:], rtol=1e-9, atol=1e-15)


@LAW
@given(SEEDS)
def test_a_mirror_image_is_told_apart_by_the_signed_volume_alone(seed):
    x, y, a, b = random_pairs(np.random.default_rng(seed))
    mirror = np.array([1.0, 1.0, -1.0])
    before, after = pair_invariants(x, y, a, b), pair_invariants(x * mirror, y * mirror, a * mirror, b * mirror)
    np.testing.assert_allclose(after[:, :6], before[:, :6], rtol=1e-9, atol=1e-15)
    np.testing.assert_allclose(after[:, 6], -before[:, 6], rtol=1e-9, atol=1e-15)


@LAW
@given(SEEDS)
def test_two_equal_pairs_give_the_rotation_between_them(seed):
    rng = np.random.default_rng(seed)
    x, y, a, b = random_pairs(rng)
    T = random_transform(rng)
    target = (y - x, a, b)
    base = tuple(rotate_vectors(v, T) for v in target)
    R = align_pairs(base, target, np.linalg.norm(y - x, axis=1), 0.15, 2e-6)
    np.testing.assert_allclose(R, np.broadcast_to(T.rotation.as_matrix(), R.shape), atol=1e-6)


def test_noise_of_the_stated_size_gives_a_whitened_distance_near_the_number_of_invariants():
    rng = np.random.default_rng(3)
    x, y, a, b = random_pairs(rng, n=4000)
    turn = Rotation.from_rotvec([0.3, -1.0, 2.0])
    noisy = (
        turn.apply(x + 0.05 * rng.standard_normal(x.shape)),
        turn.apply(y + 0.05 * rng.standard_normal(y.shape)),
        turn.apply(a + 1e-6 * rng.standard_normal(a.shape)),
        turn.apply(b + 1e-6 * rng.standard_normal(b.shape)),
    )
    norm = float(np.median(np.linalg.norm(a, axis=1)))
    one, other = (whiten_pairs(pair_invariants(*p), 0.05, 1e-6, norm) for p in ((x, y, a, b), noisy))
    distance2 = ((one - other) ** 2).sum(axis=1)
    assert 0.5 * one.shape[1] < np.median(distance2) < 1.5 * one.shape[1]
