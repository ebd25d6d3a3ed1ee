# SPDX-License-Identifier: BSD-3-Clause
"""A pose in the surveys' frames: its covariance moves with the axes and about the origin; what is free is named."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.spatial.transform import RigidTransform, Rotation

from hand_made import WeighedPose
from magmatch.geometry import perturbation, perturbation_between, random_transform
from magmatch.registration.decide.estimate import Estimate

HERE = RigidTransform.identity()
# m and rad
LIMITS = (0.3, 0.06)


def drawn(seed, scale=1.0):
    """A covariance of six numbers in units of the limits."""
    root = np.random.default_rng(seed).standard_normal((6, 6)) * np.repeat([LIMITS[1], LIMITS[0]], 3)[:, None]
    return scale * root @ root.T


def estimate_of(C, center=(0.0, 0.0, 0.0), R=None):
    T = HERE if R is None else RigidTransform.from_rotation(R)
    return Estimate(T, np.array(center), C)


def test_a_pose_is_said_between_the_surveys_own_frames():
    rng = np.random.default_rng(0)
    T_pose, T_base, T_target = (random_transform(rng) for _ in range(3))
    center = rng.normal(size=3)
    found = Estimate.of(WeighedPose(T_pose, center=center), T_base, T_target)
    expected = T_base * T_pose * T_target.inv()
    np.testing.assert_allclose(found.T_base_target.as_matrix(), expected.as_matrix(), atol=1e-12)
    # The same point of the base, whichever frames it is asked in.
    seen = T_base.apply(T_pose.apply(center))
    np.testing.assert_allclose(found.T_base_target.apply(found.center), seen, atol=1e-12)


@given(st.integers(0, 2**32 - 1))
def test_the_covariance_in_survey_axes_is_about_their_own_origin(seed):
    """Lever arm and its sign: one motion, about the centre in model axes and about the origin in survey axes."""
    rng = np.random.default_rng(seed)
    T_pose, T_base, T_target = (random_transform(rng) for _ in range(3))
    center, xi = 3 * rng.normal(size=3), 1e-6 * rng.normal(size=6)
    pose = WeighedPose(T_pose, center=center, covariance=np.outer(xi, xi))
    found = Estimate.of(pose, T_base, T_target)
    moved = Estimate.of(WeighedPose(T_pose * perturbation(xi, center), center=center), T_base, T_target)
    step = found.T_base_target.inv() * moved.T_base_target
    eta = np.concatenate([step.rotation.as_rotvec(), step.translation])
    size = np.abs(np.outer(eta, eta)).max()
    np.testing.assert_allclose(found.covariance_about_origin, np.outer(eta, eta), atol=1e-4 * size)
    np.testing.assert_array_equal(found.covariance_about_origin, found.covariance_about_origin.T)


@pytest.mark.parametrize("k", range(6))
def test_a_free_direction_is_the_one_in_survey_axes_in_which_the_covariance_is_large(k):
    """Lever arm included: xi xi^T of the direction against the same covariance about the survey's origin."""
    rng = np.random.default_rng(k)
    T_target, center, one = random_transform(rng), rng.normal(size=3), np.zeros((6, 6))
    one[k, k] = 1.0
    C = np.diag([1e-6] * 3 + [1e-4] * 3) * (np.arange(6) != k) + one
    (free,) = Estimate.of(WeighedPose(center=center, covariance=C), HERE, T_target).free_directions((0.3, 0.1))
    alone = Estimate.of(WeighedPose(center=center, covariance=one), HERE, T_target).covariance_about_origin
    large = np.linalg.eigh(alone)[1][:, -1]
    np.testing.assert_allclose(np.outer(free.xi, free.xi), np.outer(large, large), atol=1e-9)
    assert np.linalg.norm(free.xi) == pytest.approx(1)
    assert free.words.startswith("turning about base" if k < 3 else "sliding along base")


def test_directions_are_free_beyond_what_is_allowed_worst_first_and_named_in_the_bases_axes():
    just = np.diag([0.059**2] * 3 + [0.299**2] * 3)
    assert estimate_of(just).free_directions(LIMITS) == ()
    C = np.diag([0.061**2, 1e-6, 1e-6, 1e-6, 1.0, 1e-6])
    found = estimate_of(C).free_directions(LIMITS)
    assert [d.words for d in found] == ["sliding along base y", "turning about base x"]
    turned = estimate_of(C, R=Rotation.from_euler("z", 90, degrees=True)).free_directions(LIMITS)
    assert [d.words for d in turned] == ["sliding along base x", "turning about base y"]
    askew = estimate_of(C, R=Rotation.from_euler("z", -45, degrees=True)).free_directions(LIMITS)
    assert "(+0.71, +0.71, " in askew[0].words


def test_a_pose_without_a_covariance_is_not_known_at_all():
    found = Estimate.of(WeighedPose(covariance=None), HERE, HERE)
    assert (found.covariance, found.covariance_about_origin) == (None, None)
    assert found.worst_sd == (np.inf, np.inf)
    assert found.free_directions(LIMITS) == ()


def test_a_pose_under_several_models_has_the_moments_of_their_mixture():
    """Of the drawn poses: to first order in how far the models' poses are apart."""
    rng, center, T = np.random.default_rng(3), np.array([4.0, -2.0, 1.0]), random_transform(np.random.default_rng(4))
    models = [
        Estimate(T * perturbation(off, center), center, 1e-6 * (np.eye(6) + np.outer(off, off) / (off @ off)))
        for off in 2e-3 * rng.standard_normal((2, 6))
    ]
    mixed = Estimate.mixture(models, [0.15, 0.45])
    drawn_off = np.concatenate([
        perturbation_between(mixed.T_base_target, one.T_base_target, center)
        + rng.multivariate_normal(np.zeros(6), one.covariance, n)
        for one, n in zip(models, (50_000, 150_000), strict=True)
    ])  # fmt: skip
    np.testing.assert_allclose(drawn_off.mean(axis=0), 0, atol=3e-5)
    np.testing.assert_allclose(mixed.covariance, np.cov(drawn_off.T), atol=1e-7)
    assert Estimate.mixture(models[:1], [0.3]) is models[0]
    # A model under which a direction is not known leaves the best one as it is.
    assert Estimate.mixture([models[0], Estimate(T, center, None)], [0.6, 0.4]) is models[0]


def test_uncertainty_is_said_where_the_target_lies_not_at_a_far_origin():
    # 1 mrad about a centre 100 m from the origin, known to 5 mm there: the origin itself is unsure by 0.1 m.
    turn, shift = 1e-3, 5e-3
    found = estimate_of(np.diag([turn**2] * 3 + [shift**2] * 3), (100.0, 0.0, 0.0))
    assert np.sqrt(np.trace(found.covariance_about_origin[3:, 3:])) > 0.1
    assert found.worst_sd == pytest.approx((shift, turn))
    assert found.free_directions((2 * shift, 2 * turn)) == ()
