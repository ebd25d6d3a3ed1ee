# SPDX-License-Identifier: BSD-3-Clause
"""Covariances of a pose: what cells and drift make of it, its frame, what is free, which encloses another."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.spatial.transform import RigidTransform, Rotation

from magmatch.geometry import random_transform
from magmatch.registration.refine.refinement import RefinedPose, ResidualBlock, perturbation
from magmatch.registration.refine.sensors import SensorConfig, identical_sensors
from magmatch.registration.result import RegistrationResult, Status
from magmatch.registration.weigh.covariance import (
    drift_covariance,
    enclosing,
    free_directions,
    joint_covariance,
    to_survey_axes,
)

SCALE = np.array([1e-3, 2e-3, 1e-3, 0.01, 0.03, 0.02])


def drawn(seed, rank=6):
    """Covariance of six numbers in units of rad and m."""
    root = np.random.default_rng(seed).standard_normal((6, rank)) * SCALE[:, None]
    return root @ root.T


def smallest(difference):
    """Least eigenvalue in units of the scale."""
    return np.linalg.eigvalsh(difference / np.outer(SCALE, SCALE)).min()


@given(st.integers(0, 2**32 - 1), st.integers(0, 2**32 - 1), st.integers(1, 6))
def test_it_is_below_neither(first, second, rank):
    one, other = drawn(first), drawn(second, rank)
    both = enclosing(one, other)
    assert smallest(both - one) > -1e-9
    assert smallest(both - other) > -1e-9
    assert smallest(one + other - both) > -1e-9


@given(st.integers(0, 2**32 - 1), st.floats(0, 1))
def test_what_is_enclosed_already_changes_nothing(seed, share):
    one = drawn(seed)
    np.testing.assert_allclose(enclosing(one, share * one), one, rtol=1e-9, atol=1e-15)


@given(st.integers(0, 2**32 - 1), st.floats(1, 1e6))
def test_a_multiple_encloses(seed, factor):
    one = drawn(seed)
    np.testing.assert_allclose(enclosing(one, factor * one), factor * one, rtol=1e-6, atol=1e-12 * factor)


@given(st.integers(0, 2**32 - 1), st.integers(0, 2**32 - 1), st.integers(0, 2**32 - 1))
def test_it_turns_with_the_axes(first, second, turn):
    Q = np.linalg.qr(np.random.default_rng(turn).standard_normal((6, 6)))[0]
    one, other = (drawn(seed) / np.outer(SCALE, SCALE) for seed in (first, second))
    turned = enclosing(Q @ one @ Q.T, Q @ other @ Q.T)
    np.testing.assert_allclose(turned, Q @ enclosing(one, other) @ Q.T, rtol=1e-6, atol=1e-6 * np.abs(turned).max())


def test_nothing_known_of_one_leaves_the_other():
    one, other = np.diag([0.0, *np.ones(5)]), np.eye(6)
    np.testing.assert_allclose(enclosing(one, other), np.eye(6), atol=1e-9)


def test_a_direction_that_is_known_exactly_is_kept():
    one, other = np.diag([0.0, *np.ones(5)]), np.diag([0.0, 4.0, *0.5 * np.ones(4)])
    assert np.diag(enclosing(one, other)) == pytest.approx([0, 4, 1, 1, 1, 1], abs=1e-9)


def pose_with(blocks, prior=None, center=(0.0, 0.0, 0.0)):
    """A pose whose sensor is known."""
    known = np.zeros((6, 6)) if prior is None else prior
    sensor = identical_sensors(SensorConfig(mode="none"), -1)
    return RefinedPose(RigidTransform.identity(), np.array(center), sensor, np.full(3, 1.0), known, tuple(blocks))


def block_of(J, residual, positions, drift=None):
    """Of unit weights: nine columns, of which the sensor's are independent of the pose's."""
    drift = np.zeros((9, 9)) if drift is None else drift
    scores = np.zeros((len(J), 9))
    scores[:, :6] = J * residual[:, None]
    A = np.eye(9)
    A[:6, :6] = J.T @ J
    return ResidualBlock(A, A, scores, positions, residual**2, drift)


def sums_of(block, side):
    cells = np.unique(np.floor(block.positions / side), axis=0, return_inverse=True)[1].ravel()
    return np.stack([np.bincount(cells, column) for column in block.scores.T], axis=1)


@pytest.mark.parametrize("n_blocks", [1, 2])
def test_the_joint_covariance_is_a_sandwich_over_cells_added_over_blocks(n_blocks):
    rng = np.random.default_rng(0)
    prior = np.diag(rng.uniform(1, 5, 6))
    blocks = [
        block_of(rng.normal(size=(400, 6)), rng.normal(size=400), rng.uniform(0, 1, (400, 3)))
        for _ in range(n_blocks)
    ]
    pose = pose_with(blocks, prior)
    expected = np.zeros((9, 9))
    for block in blocks:
        known = np.zeros((9, 9))
        known[:6, :6], known[6:, 6:] = prior, np.eye(3)
        sums = sums_of(block, 0.3)
        n = len(sums)
        bread = np.linalg.inv(block.curvature + known)
        # The scatter about their mean, and three cells' worth for what is fitted.
        expected += bread @ (np.cov(sums.T, bias=True) * n * n / (n - 3) + known) @ bread
    np.testing.assert_allclose(joint_covariance(pose, 0.3), expected, rtol=1e-6)


def test_estimates_from_errors_that_cells_share_scatter_as_the_covariance_says():
    """NEES and coverage from both sides, over 400 surveys of 125 cells."""
    rng = np.random.default_rng(1)
    x = rng.uniform(0, 1, (1000, 3))
    cells = np.unique(np.floor(x / 0.2), axis=0, return_inverse=True)[1].ravel()
    nees, is_covered = [], []
    for _ in range(400):
        J = rng.normal(size=(1000, 6))[cells] + 0.3 * rng.normal(size=(1000, 6))
        error = 0.7 * rng.normal(size=125)[cells] + 0.3 * rng.normal(size=1000)
        A = J.T @ J
        xi = np.linalg.solve(A, J.T @ error)
        C = joint_covariance(pose_with([block_of(J, error - J @ xi, x)]), 0.2)[:6, :6]
        nees.append(xi @ np.linalg.solve(C, xi) / 6)
        is_covered.append(np.abs(xi) < 1.96 * np.sqrt(np.diag(C)))
    # 125 cells, six of them spent on the fit, tell a variance to some tenth.
    assert 0.95 < np.mean(nees) < 1.3
    assert 0.9 < np.mean(is_covered) < 0.96


def test_too_few_cells_or_a_direction_that_nothing_fixes_give_no_covariance():
    rng = np.random.default_rng(2)
    J, x = rng.normal(size=(90, 6)), rng.uniform(0, 1, (90, 3))
    assert joint_covariance(pose_with([block_of(J, rng.normal(size=90), x * [3, 1, 1])]), 1.0) is None
    assert joint_covariance(pose_with([block_of(J, rng.normal(size=90), x * [4, 1, 1])]), 1.0) is not None
    J[:, 5] = J[:, 4]
    assert joint_covariance(pose_with([block_of(J, rng.normal(size=90), x)]), 0.3) is None
    assert joint_covariance(pose_with([]), 0.3) is None


def test_a_pose_follows_drift_as_least_squares_does_of_each_survey_by_itself():
    """Unlike drifts of base and target: what each adds to the scores, through the information of its own side."""
    rng = np.random.default_rng(3)
    expected, blocks = np.zeros((6, 6)), []
    prior = np.diag(rng.uniform(1, 5, 6))
    for size in (0.01, 0.2):
        J = rng.normal(size=(200, 6))
        walk = np.arange(200) / 20
        K = size**2 * np.exp(-np.abs(walk[:, None] - walk))
        drift = np.zeros((9, 9))
        drift[:6, :6] = J.T @ K @ J
        blocks.append(block_of(J, rng.normal(size=200), rng.uniform(0, 1, (200, 3)), drift))
        gain = np.linalg.solve(J.T @ J + prior, J.T)
        expected += gain @ K @ gain.T
    np.testing.assert_allclose(drift_covariance(pose_with(blocks, prior)), expected, rtol=1e-6)


def test_uncertainty_is_said_where_the_target_lies_not_at_a_far_origin():
    # 1 mrad about a centre 100 m from the origin, known to 5 mm there: the origin itself is unsure by 0.1 m.
    center, turn, shift = np.array([100.0, 0.0, 0.0]), 1e-3, 5e-3
    about_center = np.diag([turn**2] * 3 + [shift**2] * 3)
    C = to_survey_axes(about_center, center, RigidTransform.identity())
    result = RegistrationResult(Status.ACCEPTED, "", RigidTransform.identity(), covariance=C)
    np.testing.assert_allclose(result.standard_deviations, [np.sqrt(3) * turn, np.sqrt(3) * shift], rtol=1e-6)
    assert np.sqrt(np.trace(C[3:, 3:])) > 0.1


def test_survey_axes_turn_about_their_own_origin():
    rng = np.random.default_rng(4)
    T_survey_model, center, xi = random_transform(rng), rng.normal(size=3), 1e-6 * rng.normal(size=6)
    # The same motion, about the centre in model axes and about the origin in survey axes.
    moved = T_survey_model * perturbation(xi, center) * T_survey_model.inv()
    eta = np.concatenate([moved.rotation.as_rotvec(), moved.translation])
    C = to_survey_axes(np.outer(xi, xi), center, T_survey_model)
    np.testing.assert_allclose(C, np.outer(eta, eta), atol=1e-5 * np.abs(np.outer(eta, eta)).max())


@pytest.mark.parametrize("k", range(6))
def test_a_free_direction_is_the_one_in_survey_axes_in_which_the_covariance_is_large(k):
    """Lever arm included: xi xi^T of the direction against the same covariance in survey axes."""
    rng = np.random.default_rng(k)
    T_survey_model, center = random_transform(rng), rng.normal(size=3)
    C = np.diag([1e-6] * 3 + [1e-4] * 3)
    C[k, k] = 1.0
    (free,) = free_directions(C, center, T_survey_model, np.eye(3), 0.1, 0.3)
    large = np.linalg.eigh(to_survey_axes(C - np.diag(np.diag(C) * (np.arange(6) != k)), center, T_survey_model))[1][
        :, -1
    ]
    np.testing.assert_allclose(np.outer(free.xi, free.xi), np.outer(large, large), atol=1e-9)
    assert free.words.startswith("turning about base" if k < 3 else "sliding along base")


def test_directions_are_free_beyond_what_is_allowed_worst_first_and_named_in_the_bases_axes():
    limits, identity = (0.06, 0.3), RigidTransform.identity()
    just = np.diag([0.059**2] * 3 + [0.299**2] * 3)
    assert free_directions(just, np.zeros(3), identity, np.eye(3), *limits) == ()
    C = np.diag([0.061**2, 1e-6, 1e-6, 1e-6, 1.0, 1e-6])
    found = free_directions(C, np.zeros(3), identity, np.eye(3), *limits)
    assert [d.words for d in found] == ["sliding along base y", "turning about base x"]
    R = Rotation.from_euler("z", 90, degrees=True).as_matrix()
    turned = free_directions(C, np.zeros(3), identity, R, *limits)
    assert [d.words for d in turned] == ["sliding along base x", "turning about base y"]
    askew = Rotation.from_euler("z", -45, degrees=True).as_matrix()
    assert "(+0.71, +0.71, " in free_directions(C, np.zeros(3), identity, askew, *limits)[0].words
