"""Compiled rows of a prior are those that SciPy's rotations and dense algebra give."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial.transform import RigidTransform, Rotation

from magmatch.estimation.pose_prior import PosePrior
from magmatch.estimation.prior_rows import _rotation_vector
from magmatch.geometry import skew

CENTER = np.array([0.4, -0.2, 0.7])


def rotation_vector(R):
    r = np.zeros(6)
    _rotation_vector(np.ascontiguousarray(R), r)
    return r[:3]


@settings(max_examples=200, deadline=None)
@given(
    seed=st.integers(0, 10_000),
    angle=st.one_of(st.floats(0, np.pi), st.sampled_from([0.0, 1e-12, 1e-8, np.pi - 1e-3, np.pi - 1e-7])),
)
def test_a_rotation_vector_is_scipy_s(seed, angle):
    axis = np.random.default_rng(seed).standard_normal(3)
    R = Rotation.from_rotvec(angle * axis / np.linalg.norm(axis))
    np.testing.assert_allclose(rotation_vector(R.as_matrix()), R.as_rotvec(), atol=1e-8)


@pytest.mark.parametrize("axis", np.eye(3))
def test_half_a_turn_is_half_a_turn(axis):
    found = rotation_vector(Rotation.from_rotvec(np.pi * axis).as_matrix())
    np.testing.assert_allclose(np.abs(found), np.pi * axis, atol=1e-12)


def some_prior(rng):
    """A rough pose, a vertical and a height, all at odds with each other."""
    C = rng.standard_normal((6, 6))
    ups = Rotation.random(2, rng=rng).as_matrix()[:, :, 2]
    T = RigidTransform.from_components(rng.standard_normal(3), Rotation.random(rng=rng))
    return PosePrior(3.0, T, C @ C.T + 0.1 * np.eye(6), ups[0], ups[1], 0.2, 0.3, 0.1, 2.0)


@settings(max_examples=20, deadline=None)
@given(seed=st.integers(0, 10_000))
def test_rows_are_those_of_dense_algebra(seed):
    rng = np.random.default_rng(seed)
    prior, R, moved = some_prior(rng), Rotation.random(5, rng=rng).as_matrix(), rng.standard_normal((5, 3))
    R0 = prior.T_base_target.as_matrix()[:3, :3]
    for k, found in enumerate(zip(*prior.rows_of_many(R, moved, CENTER), strict=True)):
        seen, D = prior.up_base @ R[k], R0.T @ R[k]
        turn = Rotation.from_matrix(D).as_rotvec()
        of_pose = np.eye(6)
        of_pose[:3, :3] += 0.5 * skew(turn)
        of_pose[3:, 3:] = D
        off = np.concatenate([
            prior.up_target - seen,
            [moved[k] @ prior.up_base - CENTER @ prior.up_target - prior.height],
            turn, R0.T @ (moved[k] - prior.T_base_target.apply(CENTER)),
        ])  # fmt: skip
        J = np.zeros((10, 6))
        J[:3, :3], J[3, 3:], J[4:] = -skew(seen), seen, of_pose
        P = np.zeros((10, 10))
        P[:3, :3], P[3, 3] = np.eye(3) / prior.gravity_sd**2, prior.height_sd**-2
        P[4:, 4:] = np.linalg.inv(prior.covariance)
        for one, expected in zip(found, (J.T @ P @ J, J.T @ P @ off, off @ P @ off), strict=True):
            np.testing.assert_allclose(one, expected, rtol=1e-8, atol=1e-8 * np.abs(P).max())


@settings(max_examples=20, deadline=None)
@given(seed=st.integers(0, 10_000))
def test_a_pose_is_ruled_out_by_its_turn_or_by_its_shift(seed):
    rng = np.random.default_rng(seed)
    prior, slack = some_prior(rng), (0.1, 0.2)
    prior = PosePrior(3.0, prior.T_base_target, prior.covariance)
    R = (prior.T_base_target.rotation * Rotation.from_rotvec(rng.normal(0, 1.5, (300, 3)))).as_matrix()
    moved = prior.T_base_target.apply(CENTER + rng.normal(0, 6, (300, 3)))
    turn = (prior.T_base_target.rotation.inv() * Rotation.from_matrix(R)).as_rotvec()
    shift = prior.T_base_target.inv().apply(moved) - CENTER
    expected = np.ones(300, dtype=bool)
    for off, C, own in ((turn, prior.covariance[:3, :3], 0.1), (shift, prior.covariance[3:, 3:], 0.2)):
        expected &= (off * np.linalg.solve(C + own**2 * np.eye(3), off.T).T).sum(axis=1) < prior.far2
    assert 0 < expected.sum() < 300
    np.testing.assert_array_equal(prior.admits(R, moved, CENTER, slack), expected)
