# SPDX-License-Identifier: BSD-3-Clause
"""Ellipsoids hold what they say, at the place they say, in the base's axes."""

import numpy as np
import pytest
from scipy.stats import chi2

from magmatch.geometry import exp_se3, random_transform
from magmatch.registration.result import DegenerateDirection
from magmatch.viz.figures.ellipsoids import LEVEL, direction_words, ellipsoids_at, swept


@pytest.fixture
def case():
    rng = np.random.default_rng(3)
    A = rng.normal(size=(6, 6)) * np.array([1e-3] * 3 + [5e-3] * 3)[:, None]
    return rng, A @ A.T, random_transform(rng), np.array([8.0, -3.0, 1.0])


def inside(ellipsoid, v):
    return ((v @ ellipsoid.directions.T / ellipsoid.half_axes) ** 2).sum(axis=1) <= 1


def test_ellipsoids_hold_their_share_of_drawn_transforms(case):
    rng, covariance, T, center = case
    truths = [T * exp_se3(xi) for xi in rng.multivariate_normal(np.zeros(6), covariance, 4000)]
    place, turn = ellipsoids_at(covariance, T, center)
    shifts = np.array([S.apply(center) for S in truths]) - T.apply(center)
    turns = np.array([(S.rotation * T.rotation.inv()).as_rotvec() for S in truths])
    # Four standard errors of a share of 4000 draws, and the second order of the exponential.
    assert inside(place, shifts).mean() == pytest.approx(LEVEL, abs=0.015)
    assert inside(turn, turns).mean() == pytest.approx(LEVEL, abs=0.015)


def test_the_surface_is_where_the_squared_distance_is_the_quantile(case):
    _, covariance, T, _ = case
    place, _ = ellipsoids_at(covariance, T, np.zeros(3))
    R = T.rotation.as_matrix()
    v = place.surface(8).reshape(-1, 3)
    distance2 = np.einsum("ni,ij,nj->n", v, np.linalg.inv(R @ covariance[3:, 3:] @ R.T), v)
    np.testing.assert_allclose(distance2, chi2.ppf(LEVEL, 3), rtol=1e-6)


def test_half_axes_come_longest_first(case):
    _, covariance, T, center = case
    for ellipsoid in ellipsoids_at(covariance, T, center):
        assert (np.diff(ellipsoid.half_axes) <= 0).all()


@pytest.mark.parametrize("k", range(6))
def test_sweeping_moves_the_farthest_sample_as_far_as_asked(case, k):
    rng, _, T, center = case
    p = center + rng.normal(size=(50, 3))
    moved = swept(p, T, DegenerateDirection(np.eye(6)[k], "words"), 1e-4)
    lengths = np.linalg.norm(moved - T.apply(p), axis=1)
    assert lengths.max() == pytest.approx(1e-4, rel=1e-3)


def test_directions_are_named_where_they_are_near_an_axis():
    assert direction_words(np.array([0.01, -1.0, 0.0])) == "base y"
    assert direction_words(np.array([-1.0, -1.0, 0.0])) == "(+0.71, +0.71, -0.00)"
