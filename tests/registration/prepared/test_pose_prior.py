"""What is known of the pose beforehand is used, and not obeyed where the field denies it."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial.transform import RigidTransform, Rotation
from scipy.stats import multivariate_normal

from magmatch.geometry import random_transform, transform_error
from magmatch.registration.config import RegistrationConfig
from magmatch.registration.prepared.pose_prior import PosePrior, PosePriorConfig, pose_prior
from magmatch.registration.refine.refinement import perturbation
from magmatch.registration.register import register
from magmatch.registration.search.invariant_search import InvariantSearchConfig

SD = np.array([0.1, 0.1, 0.1, 0.5, 0.5, 0.5])
CENTER = np.array([0.4, -0.2, 0.7])


def some_prior(seed, *, has_pose=True, is_aligned=True):
    rng = np.random.default_rng(seed)
    T = random_transform(rng)
    up = T.rotation.apply([0.0, 0.6, 0.8]) if is_aligned else None
    given_pose = (T, SD) if has_pose else (None, None)
    return T, PosePrior(20.0, *given_pose, up, np.array([0.0, 0.6, 0.8]) if is_aligned else None, 0.02)


def about(rng, turn=0.05, shift=0.3):
    return perturbation(np.concatenate([turn * rng.standard_normal(3), shift * rng.standard_normal(3)]), CENTER)


@settings(max_examples=20, deadline=None)
@given(seed=st.integers(0, 10_000), has_pose=st.booleans(), is_aligned=st.booleans())
def test_the_gradient_is_that_of_half_the_squared_residual(seed, has_pose, is_aligned):
    T, prior = some_prior(seed, has_pose=has_pose, is_aligned=is_aligned)
    T = T * about(np.random.default_rng(seed))
    _, slope, chi2 = prior.rows(T, CENTER)
    step = 1e-6
    found = [(prior.rows(T * perturbation(step * e, CENTER), CENTER)[2] - chi2) / (2 * step) for e in np.eye(6)]
    # The rotation's Jacobian is of first order in the angle.
    np.testing.assert_allclose(slope, found, rtol=0.01, atol=0.02 * max(1.0, np.abs(slope).max()))


def test_the_density_of_a_rough_pose_is_gaussian():
    T, prior = some_prior(1, is_aligned=False)
    expected = multivariate_normal(np.zeros(6), np.diag(SD**2)).logpdf(np.zeros(6))
    assert prior.log_density(T, CENTER) == pytest.approx(expected)


def test_knowing_the_vertical_leaves_the_turns_about_it():
    """Averaged over all rotations, the density is that of knowing nothing."""
    _, prior = some_prior(2, has_pose=False)
    nothing = PosePrior(20.0)
    rotations = Rotation.random(200_000, random_state=np.random.default_rng(0))
    tilt2 = ((prior.up_target - rotations.inv().apply(prior.up_base)) ** 2).sum(axis=1)
    at_best = prior.log_density(RigidTransform.from_rotation(_upright(prior)), CENTER)
    mean = np.mean(np.exp(at_best - 0.5 * tilt2 / prior.gravity_sd**2))
    assert mean == pytest.approx(np.exp(nothing.log_density(RigidTransform.identity(), CENTER)), rel=0.3)


def _upright(prior):
    axis = np.cross(prior.up_target, prior.up_base)
    angle = np.arctan2(np.linalg.norm(axis), prior.up_target @ prior.up_base)
    return Rotation.from_rotvec(angle * axis / np.linalg.norm(axis))


def test_a_prior_does_not_depend_on_the_frames_it_is_stated_in():
    rng = np.random.default_rng(5)
    config = PosePriorConfig(pose=(1.0, 2.0, 0.5, 0.0, 0.0, 0.6, 0.8), is_gravity_aligned=True)
    A, B, C = random_transform(rng), random_transform(rng), config.transform() * about(rng)
    here = pose_prior(config, RigidTransform.identity(), RigidTransform.identity(), 10.0)
    there = pose_prior(config, A, B, 10.0)
    moved = there.log_density(A.inv() * C * B, B.inv().apply(CENTER))
    assert moved == pytest.approx(here.log_density(C, CENTER), rel=1e-9)


def test_a_rough_pose_must_be_a_pose():
    with pytest.raises(ValueError, match="unit quaternion"):
        PosePriorConfig(pose=(0.0, 0.0, 0.0, 1.0, 1.0, 0.0, 0.0))


@pytest.fixture(scope="module")
def pair(make_exact_pair):
    """One room seen twice, z up in both frames."""
    T = RigidTransform.from_components([0.7, -0.4, 0.2], Rotation.from_euler("z", 130, degrees=True))
    return *make_exact_pair(11, T), T


FEW = RegistrationConfig(invariants=InvariantSearchConfig(n_anchors=100, n_coarse=80, n_fine=15))


def registered(base, target, **prior):
    return register(base, target, FEW.model_copy(update={"prior": PosePriorConfig(**prior)}))


def numbers_of(T):
    return (*map(float, T.translation), *map(float, T.rotation.as_quat()))


def test_a_wrong_prior_does_not_force_a_wrong_answer(pair):
    base, target, T = pair
    off = RigidTransform.from_components([1.2, 0.9, 0.0], Rotation.from_euler("z", 120, degrees=True))
    wrong = registered(base, target, pose=numbers_of(T * off), sd_translation=0.2, sd_rotation=0.1)
    tilted = T * RigidTransform.from_rotation(Rotation.from_euler("x", 40, degrees=True))
    leaning = target.transformed(tilted.inv() * T)
    assert not wrong.is_accepted
    assert not registered(base, leaning, is_gravity_aligned=True).is_accepted
