# SPDX-License-Identifier: BSD-3-Clause
"""Ellipsoids hold what they say, at the place they say, in the base's axes."""

import numpy as np
import pytest
from scipy.spatial.transform import RigidTransform
from scipy.stats import chi2

from hand_made import exp_se3
from magmatch.geometry import adjoint, covariance_about, random_transform
from magmatch.registration.result import DegenerateDirection
from magmatch.viz.figures.certainty_figures import LEVEL, direction_words, ellipsoids_at, swept


@pytest.fixture
def case():
    rng = np.random.default_rng(3)
    A = rng.normal(size=(6, 6)) * np.array([1e-3] * 3 + [5e-3] * 3)[:, None]
    return rng, A @ A.T, random_transform(rng), np.array([8.0, -3.0, 1.0])


def inside(ellipsoid, v):
    return ((v @ ellipsoid.directions.T / ellipsoid.half_axes) ** 2).sum(axis=1) <= 1


def test_ellipsoids_hold_their_share_of_drawn_transforms(case):
    rng, covariance, T, center = case
    truths = [T * exp_se3(xi) for xi in rng.multivariate_normal(np.zeros(6), covariance, 1000)]
    place, turn = ellipsoids_at(covariance, T, center)
    shifts = np.array([S.apply(center) for S in truths]) - T.apply(center)
    turns = np.array([(S.rotation * T.rotation.inv()).as_rotvec() for S in truths])
    # Four standard errors of a share of 1000 draws, and the second order of the exponential.
    assert inside(place, shifts).mean() == pytest.approx(LEVEL, abs=0.03)
    assert inside(turn, turns).mean() == pytest.approx(LEVEL, abs=0.03)


@pytest.mark.parametrize("origin", [(691234.5, 5334567.25, 512.0), (4177654.1, 855321.7, 4727811.3)])
def test_ellipsoids_are_the_same_about_a_far_origin(case, origin):
    _, covariance, T, center = case
    M = adjoint(RigidTransform.from_translation(origin))
    far = ellipsoids_at(M @ covariance @ M.T, T, center + origin)
    # To a hundredth: of the metres that a turn of mrad is at 5,000 km, float64 keeps some 1e-8 m^2.
    for there, here in zip(far, ellipsoids_at(covariance, T, center), strict=True):
        np.testing.assert_allclose(there.half_axes, here.half_axes, rtol=0.01)


def test_a_covariance_stays_definite_where_rounding_about_a_far_origin_took_all():
    covariance = np.diag([1e-6] * 3 + [1e-12] * 3)  # micrometres
    origin = np.array([4177654.1, 855321.7, 4727811.3])
    M = adjoint(RigidTransform.from_translation(origin))
    for point in origin + np.random.default_rng(0).normal(size=(20, 3)):
        about = covariance_about(M @ covariance @ M.T, point)
        assert np.linalg.eigvalsh(about)[0] > 0
        # A metre or two turned by 1 mrad; what is added is what float64 rounds off, a tenth of a millimetre.
        assert np.sqrt(np.diagonal(about)[3:].max()) < 3e-3


def test_sweeping_turns_samples_far_from_the_origin_about_themselves(case):
    rng, _, T, center = case
    far = center + np.array([4177654.1, 855321.7, 4727811.3])
    p, theta = far + rng.normal(size=(50, 3)), np.array([0.0, 0.6, 0.8])
    xi = np.concatenate([theta, -np.cross(theta, far)])
    moved = swept(np.vstack([p, far]), T, DegenerateDirection(xi / np.linalg.norm(xi), "turning"), 0.1)
    lengths = np.linalg.norm(moved - T.apply(np.vstack([p, far])), axis=1)
    assert lengths.max() == pytest.approx(0.1, rel=1e-3)
    assert lengths[-1] < 1e-6


def test_the_surface_is_where_the_squared_distance_is_the_quantile(case):
    _, covariance, T, _ = case
    place, _ = ellipsoids_at(covariance, T, np.zeros(3))
    R = T.rotation.as_matrix()
    v = place.surface(8).reshape(-1, 3)
    distance2 = np.einsum("ni,ij,nj->n", v, np.linalg.inv(R @ covariance[3:, 3:] @ R.T), v)
    np.testing.assert_allclose(distance2, chi2.ppf(LEVEL, 3), rtol=1e-6)
    assert (np.diff(place.half_axes) <= 0).all()


def test_directions_are_named_where_they_are_near_an_axis():
    assert direction_words(np.array([0.01, -1.0, 0.0])) == "base y"
    assert direction_words(np.array([-1.0, -1.0, 0.0])) == "(+0.71, +0.71, -0.00)"
