# SPDX-License-Identifier: BSD-3-Clause
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from magmatch.features.wahba import best_rotations, to_rotation

LAW = settings(deadline=None, max_examples=25)
SEEDS = st.integers(0, 2**32 - 1)


def problem(seed, n=20, n_vectors=3):
    """Vectors that no rotation brings together, and weights of very different size."""
    rng = np.random.default_rng(seed)
    base, target = (tuple(rng.standard_normal((n, 3)) for _ in range(n_vectors)) for _ in range(2))
    return base, target, tuple(10.0 ** rng.uniform(-3, 3, n) for _ in range(n_vectors))


@LAW
@given(SEEDS)
def test_rotations_are_those_of_scipy(seed):
    base, target, weights = problem(seed)
    for k, R in enumerate(best_rotations(base, target, weights)):
        a, b = (np.stack([v[k] / np.linalg.norm(v[k]) for v in side]) for side in (base, target))
        expected, _ = Rotation.align_vectors(a, b, [w[k] for w in weights])
        assert (Rotation.from_matrix(R).inv() * expected).magnitude() < 1e-6


@pytest.mark.parametrize("sign", [1.0, -1.0])
def test_one_direction_leaves_a_choice_and_still_gives_a_rotation_onto_it(sign):
    v = np.array([[0.2, -0.3, 0.5]])
    (R,) = best_rotations((sign * v, sign * v), (v, v), (np.ones(1), np.ones(1)))
    np.testing.assert_allclose(R @ v[0], sign * v[0], atol=1e-12)
    np.testing.assert_allclose(R @ R.T, np.eye(3), atol=1e-12)
    assert np.linalg.det(R) == pytest.approx(1.0)


def test_vectors_without_length_say_nothing():
    rng = np.random.default_rng(0)
    T, none, ones = Rotation.random(rng=rng), np.zeros((4, 3)), np.ones(4)
    target = tuple(rng.standard_normal((4, 3)) for _ in range(3))
    base = (*(np.ascontiguousarray(T.apply(v)) for v in target[:2]), none)
    found = best_rotations(base, target, (ones, ones, ones))
    np.testing.assert_allclose(found, np.broadcast_to(T.as_matrix(), (4, 3, 3)), atol=1e-12)
    nothing = best_rotations((none, none, none), (none, none, none), (ones, ones, ones))
    np.testing.assert_allclose(
        nothing @ np.swapaxes(nothing, 1, 2), np.broadcast_to(np.eye(3), (4, 3, 3)), atol=1e-12
    )


@LAW
@given(seed=SEEDS, n=st.integers(1, 9), spread=st.floats(0, 2))
def test_the_mean_of_rotations_is_the_nearest_one(seed, n, spread):
    """The oracle: singular vectors, without a reflection."""
    rng = np.random.default_rng(seed)
    mean = (Rotation.random(rng=rng) * Rotation.from_rotvec(rng.normal(0, spread, (n, 3)))).as_matrix().mean(axis=0)
    found = mean.copy()
    to_rotation(found, np.empty((4, 4)), np.empty((4, 4)))
    np.testing.assert_allclose(found @ found.T, np.eye(3), atol=1e-12)
    assert np.linalg.det(found) == pytest.approx(1)
    U, _, Vt = np.linalg.svd(mean)
    U[:, 2] *= np.sign(np.linalg.det(U @ Vt))
    # As near as that; where two are as near, either.
    assert np.trace(found.T @ mean) == pytest.approx(np.trace((U @ Vt).T @ mean), abs=1e-12)
