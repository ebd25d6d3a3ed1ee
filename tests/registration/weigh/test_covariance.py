# SPDX-License-Identifier: BSD-3-Clause
"""Covariances of a pose: what cells, drift and unknown maps make of it, which encloses another."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.spatial.transform import RigidTransform

from hand_made import Drawn, Polynomial, box, prepared_map, some_field
from magmatch.estimation.pose_prior import PosePrior
from magmatch.registration.refine.refinement import RefinedPose, ResidualBlock, refine, step_between
from magmatch.registration.refine.sensors import TIED_SD, identical_sensors
from magmatch.registration.weigh.covariance import drift_covariance, enclosing, joint_covariance, map_covariance

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


def test_a_direction_that_is_known_exactly_is_kept():
    one, other = np.diag([0.0, *np.ones(5)]), np.diag([0.0, 4.0, *0.5 * np.ones(4)])
    assert np.diag(enclosing(one, other)) == pytest.approx([0, 4, 1, 1, 1, 1], abs=1e-9)


def pose_with(blocks, prior=None, center=(0.0, 0.0, 0.0)):
    """A pose whose sensor is known."""
    known = np.zeros((6, 6)) if prior is None else prior
    sensor = identical_sensors("none", -1)
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


def test_the_joint_covariance_is_a_sandwich_over_cells_added_over_blocks():
    rng = np.random.default_rng(0)
    prior = np.diag(rng.uniform(1, 5, 6))
    blocks = [
        block_of(rng.normal(size=(400, 6)), rng.normal(size=400), rng.uniform(0, 1, (400, 3))) for _ in range(2)
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


def test_a_pose_follows_drift_whether_or_not_its_sensor_is_known_beforehand():
    rng = np.random.default_rng(3)
    J, drift = rng.normal(size=(200, 6)), np.zeros((9, 9))
    drift[:6, :6] = J.T @ J
    pose = pose_with([block_of(J, rng.normal(size=200), rng.uniform(0, 1, (200, 3)), drift)])
    tied = replace(pose, sensor_sd=np.full(3, TIED_SD))
    np.testing.assert_allclose(drift_covariance(tied), drift_covariance(pose), rtol=1e-6)


@pytest.mark.parametrize("sizes", [(2e-8, 0.0), (1e-8, 2e-8)])
def test_poses_in_drawn_maps_scatter_as_the_covariance_says(sizes):
    """Draws so small that one linear step is all; the tail bends less than it weighs by a tenth."""
    rng, field = np.random.default_rng(1), some_field(3, slope=10e-6)
    maps, errors = [], []
    for size in sizes:
        drawn = [
            Polynomial(size * rng.standard_normal(3), some_field(k, slope=size).linear)
            for k in rng.integers(0, 999, 6)
        ]
        prepared = prepared_map(field, box(rng, 150), noise_sd=0.3e-6, sd=1e-6, spacing=0.05)
        maps.append(replace(prepared, field_map=Drawn(field), draws=lambda drawn=drawn: drawn))
        errors.append(drawn)
    base, target = maps

    def refined(base, target):
        start = RigidTransform.identity()
        return refine(base, target, start, PosePrior(10.0), "none", np.random.default_rng(0), -1)

    best = refined(base, target)
    in_drawn = [refined(replace(base, posterior=field.plus(error)), target) for error in errors[0]]
    in_drawn += [refined(base, replace(target, posterior=field.plus(error))) for error in errors[1]]
    steps = np.array([step_between(best, pose) for pose in in_drawn])
    expected = steps.T @ steps / 6
    scale = np.sqrt(np.outer(np.diag(expected), np.diag(expected)))
    stated = map_covariance(base, target, best, seed=0)
    np.testing.assert_allclose(stated / scale, expected / scale, atol=0.1)
