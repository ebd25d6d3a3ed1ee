"""Laws of rigid motions: points, vectors and tensors move differently."""

import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial.transform import RigidTransform

from magmatch.geometry import (
    is_one_pose,
    path_moved,
    path_walked,
    perturbation,
    random_transform,
    rotate_tensors,
    rotate_third_order,
    rotate_vectors,
    transform_error,
    transform_points,
)

SEEDS = st.integers(0, 10_000)
LAW = settings(max_examples=20, deadline=None)


def two_transforms(seed):
    rng = np.random.default_rng(seed)
    return random_transform(rng), random_transform(rng), rng


@given(seed=SEEDS)
@LAW
def test_moving_twice_is_moving_by_the_product(seed):
    T_a_b, T_b_c, rng = two_transforms(seed)
    p, G, D = rng.normal(size=(5, 3)), rng.normal(size=(5, 3, 3)), rng.normal(size=(5, 3, 3, 3))
    for move, x in ((transform_points, p), (rotate_vectors, p), (rotate_tensors, G), (rotate_third_order, D)):
        np.testing.assert_allclose(move(move(x, T_b_c), T_a_b), move(x, T_a_b * T_b_c), atol=1e-12)


@given(seed=SEEDS)
@LAW
def test_derivatives_of_a_field_move_as_tensors(seed):
    # A quadratic field B_a = G_ab x_b + D_abc x_b x_c / 2 has gradient G and second derivatives D at the origin.
    T, _, rng = two_transforms(seed)
    G, D = rng.normal(size=(1, 3, 3)), rng.normal(size=(1, 3, 3, 3))
    D = D + np.swapaxes(D, 2, 3)
    R = T.rotation.as_matrix()
    x = rng.normal(size=3)
    moved_field = R @ (G[0] @ x + np.einsum("abc,b,c->a", D[0], x, x) / 2)
    y = R @ x
    G2, D2 = rotate_tensors(G, T)[0], rotate_third_order(D, T)[0]
    np.testing.assert_allclose(G2 @ y + np.einsum("abc,b,c->a", D2, y, y) / 2, moved_field, atol=1e-12)


def test_transform_error_is_measured_at_the_centre():
    T = RigidTransform.from_exp_coords([0, 0, 0.1, 0, 0, 0])
    distance, angle = transform_error(T, RigidTransform.identity(), np.array([2.0, 0.0, 0.0]))
    np.testing.assert_allclose(angle, 0.1)
    np.testing.assert_allclose(distance, 2 * 2 * np.sin(0.05))


@given(seed=SEEDS, near=st.floats(0, 2))
@LAW
def test_two_poses_are_one_where_neither_shift_nor_turn_is_too_large(seed, near):
    T, _, rng = two_transforms(seed)
    center = rng.normal(size=3)
    other = T * perturbation(near * rng.normal(size=6), center)
    shift, turn = transform_error(other, T, center)
    for a, b in ((1.01, 1.01), (0.99, 1.01), (1.01, 0.99)):
        assert is_one_pose(other, T, center, (a * shift + 1e-9, b * turn + 1e-9)) == (
            (a > 1 or shift < 1e-7) and (b > 1 or turn < 1e-7)
        )
    np.testing.assert_allclose([shift, turn], np.linalg.norm([*_apart(other, T, center)], axis=1), atol=1e-7)


def _apart(T, other, center):
    """Shift of the centre and turn, by SciPy's products."""
    yield T.apply(center) - other.apply(center)
    yield (other.inv() * T).rotation.as_rotvec()


def test_a_path_has_what_was_walked_alone_not_what_jitter_adds_where_somebody_stands():
    rng = np.random.default_rng(0)
    walk = np.linspace([0.0, 0, 0], [10.0, 0, 0], 1000) + 1e-4 * rng.standard_normal((1000, 3))
    stood = walk[:1] + 1e-3 * rng.standard_normal((3000, 3))
    assert path_moved(stood)[-1] == 0.0
    np.testing.assert_array_equal(path_moved(walk), path_walked(walk))
    # Odometry that drifts at random on short steps moves all the same.
    drifting = np.cumsum(0.01 * rng.standard_normal((1000, 3)), axis=0)
    np.testing.assert_array_equal(path_moved(drifting), path_walked(drifting))
    both = path_moved(np.concatenate([stood, walk]))
    assert abs(both[-1] - 10.0) < 0.5 < path_walked(np.concatenate([stood, walk]))[-1] - 12.0
