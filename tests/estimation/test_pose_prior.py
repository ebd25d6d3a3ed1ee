"""What is known of the pose beforehand is used, and not obeyed where the field denies it."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial.transform import RigidTransform, Rotation
from scipy.stats import chi2 as chi_square

from magmatch.estimation.candidate_poses import CandidatePoses
from magmatch.estimation.limits import MOST_DRAWN
from magmatch.estimation.pose_prior import PosePrior, PosePriorConfig, pose_prior
from magmatch.geometry import perturbation, random_transform

SD = np.array([0.1, 0.1, 0.1, 0.5, 0.5, 0.5])
CENTER = np.array([0.4, -0.2, 0.7])


def some_prior(seed, *, has_pose=True, is_aligned=True):
    rng = np.random.default_rng(seed)
    T = random_transform(rng)
    up = T.rotation.apply([0.0, 0.6, 0.8]) if is_aligned else None
    given_pose = (T, np.diag(SD**2)) if has_pose else (None, None)
    return T, PosePrior(20.0, *given_pose, up, np.array([0.0, 0.6, 0.8]) if is_aligned else None, 0.02)


def about(rng, turn=0.05, shift=0.3):
    return perturbation(np.concatenate([turn * rng.standard_normal(3), shift * rng.standard_normal(3)]), CENTER)


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


@pytest.mark.parametrize("k", range(6))
@pytest.mark.parametrize("sign", [1, -1])
def test_a_pose_is_admitted_if_one_right_one_in_a_hundred_is_as_far_from_prior_and_search_together(k, sign):
    T, prior = some_prior(4, is_aligned=False)
    slack = (0.05, 0.2)
    reach = np.sqrt(chi_square.isf(0.01, 3)) * np.hypot(SD[k], slack[k // 3])
    found = []
    for share in (0.99, 1.01):
        turn = T * perturbation(sign * share * reach * np.eye(6)[k] * (k < 3), CENTER)
        shift = RigidTransform.from_translation(sign * share * reach * np.eye(3)[k % 3] * (k >= 3))
        moved = shift * turn
        found.append(prior.admits(moved.rotation.as_matrix()[None], moved.apply(CENTER)[None], CENTER, slack)[0])
    assert found == [True, False]


def test_a_tilt_is_admitted_within_reach_and_a_turn_about_the_vertical_always():
    T, prior = some_prior(5, has_pose=False)
    reach = np.sqrt(chi_square.isf(0.01, 3)) * np.hypot(0.02, 0.1)
    across = np.cross(prior.up_target, [1.0, 0, 0])
    across /= np.linalg.norm(across)
    R = [
        (T.rotation * Rotation.from_rotvec(turn)).as_matrix()
        for turn in (0.99 * reach * across, 1.01 * reach * across, 2.5 * prior.up_target)
    ]
    assert prior.admits(np.array(R), np.zeros((3, 3)), CENTER, (0.1, 0.1)).tolist() == [True, False, True]


def test_drawn_poses_are_the_rough_one_and_others_that_scatter_about_it_as_stated():
    T, prior = some_prior(6, is_aligned=False)
    R, moved = prior.draw(4000, CENTER, np.random.default_rng(0))
    np.testing.assert_allclose(R[0], T.rotation.as_matrix(), atol=1e-12)
    np.testing.assert_allclose(moved[0], T.apply(CENTER), atol=1e-12)
    turns = (T.rotation.inv() * Rotation.from_matrix(R)).as_rotvec()
    shifts = T.inv().apply(moved) - CENTER
    xi = np.concatenate([turns, shifts], axis=1)
    np.testing.assert_allclose(xi.std(axis=0), SD, rtol=0.06)
    assert some_prior(6, has_pose=False)[1].draw(9, CENTER, np.random.default_rng(0))[0].shape == (0, 3, 3)


def test_hypotheses_are_narrowed_to_those_admitted_and_poses_near_the_rough_one_about_their_anchors():
    T, prior = some_prior(7, is_aligned=False)
    rng = np.random.default_rng(0)
    anchors = rng.normal(size=(3, 3))
    poses = [T, T * about(rng, 2.5), T * RigidTransform.from_translation([9.0, 0, 0])]
    R = np.array([P.rotation.as_matrix() for P in poses])
    pb = np.array([P.apply(a) for P, a in zip(poses, anchors, strict=True)])
    given = CandidatePoses(R, pb, np.arange(3), anchors)
    found = prior.narrow(given, CENTER, (0.01, 0.01), rng)
    R, pb, rows, about_these = found
    assert about_these is anchors
    assert len(R) == len(pb) == len(rows) == MOST_DRAWN + 1
    np.testing.assert_allclose(R[0], T.rotation.as_matrix(), atol=1e-12)
    moved = found.carry(CENTER)
    np.testing.assert_allclose(moved[1], T.apply(CENTER), atol=1e-9)
    assert prior.admits(R, moved, CENTER, (0.01, 0.01)).mean() > 0.97
    assert set(rows[1:].tolist()) == {0, 1, 2}
    # Fewer are enough for a search that tells fewer apart: one a direction, and one an anchor.
    assert len(prior.narrow(given.subset(slice(1)), CENTER, (1.0, 1.0), rng)[0]) == 6 + 1
    many = given._replace(anchors_target=np.tile(anchors, (30, 1)))
    assert set(prior.narrow(many, CENTER, (1.0, 1.0), rng).anchor_rows.tolist()) == set(range(90))
    # One a direction for each that they tell apart, times how many stand side by side where the prior is wide.
    wide = replace(prior, T_base_target=T, covariance=np.diag([1e-4, 1e-4, 1e-4, 1e-4, 1e-4, 90.0**2]))
    assert len(wide.narrow(given.subset(slice(0)), CENTER, (1.0, 1.0), rng)[0]) == 6 * 90
    flat = PosePrior(1.0)
    assert flat.narrow(given, CENTER, (0.1, 0.1), rng) is given


def planar_prior(seed):
    rng = np.random.default_rng(seed)
    A, B = random_transform(rng), random_transform(rng)
    T = RigidTransform.from_components([1.0, 2.0, 0.0], Rotation.from_euler("z", 0.7))
    config = PosePriorConfig(is_planar=True, height_sd=0.1, gravity_sd=0.02)
    return A.inv() * T * B, pose_prior(config, A, B, 20.0, 3.0), B.inv()


def test_planar_surveys_share_their_heights_and_their_vertical_whatever_their_model_frames():
    for seed in range(3):
        T, prior, to_model = planar_prior(seed)
        center = to_model.apply(CENTER)
        assert prior.rows(T, center)[2] == pytest.approx(0.0, abs=1e-18)
        raised = T * to_model * RigidTransform.from_translation([0.3, -0.4, 0.2]) * to_model.inv()
        assert prior.rows(raised, center)[2] == pytest.approx((0.2 / 0.1) ** 2)
        assert not prior.admits(raised.rotation.as_matrix()[None], raised.apply(center)[None] + 9, center, (0.1, 0.1))


@settings(max_examples=30, deadline=None)
@given(seed=st.integers(0, 10_000), kind=st.sampled_from(["pose", "vertical", "pose and vertical", "none", "planar"]))
def test_the_gradient_is_that_of_half_the_squared_residual(seed, kind):
    if kind == "planar":
        T, prior = planar_prior(seed)[:2]
        T = T * about(np.random.default_rng(seed), turn=0.01, shift=0.1)
    else:
        T, prior = some_prior(seed, has_pose="pose" in kind, is_aligned="vertical" in kind)
        T = T * about(np.random.default_rng(seed))
    slope, step = prior.rows(T, CENTER)[1], 1e-6
    half = [[prior.rows(T * perturbation(s * step * e, CENTER), CENTER)[2] / 2 for s in (1, -1)] for e in np.eye(6)]
    found = [(up - down) / (2 * step) for up, down in half]
    # The rotation's Jacobian is of first order in the angle.
    size = max(1.0, np.abs(slope).max())
    np.testing.assert_allclose(slope, found, rtol=0.01, atol=(0.01 if kind == "planar" else 0.02) * size)


@pytest.mark.parametrize("kind", ["pose", "gravity", "planar"])
def test_the_mean_density_over_a_pose_s_spread_is_that_of_many_draws(kind):
    rng = np.random.default_rng(8)
    T, prior = planar_prior(3)[:2] if kind == "planar" else some_prior(7, has_pose=kind == "pose", is_aligned=True)
    if kind == "gravity":
        T = RigidTransform.from_rotation(_upright(prior))
    T = T * about(rng, turn=0.01, shift=0.05)
    sd = np.array([0.012, 0.02, 0.015, 0.06, 0.1, 0.08])
    M = np.linalg.qr(rng.standard_normal((6, 6)))[0] * 0.2 + np.eye(6)
    C = (M * sd) @ (M * sd).T
    draws = rng.multivariate_normal(np.zeros(6), C, 20_000)
    R = (T.rotation * Rotation.from_rotvec(draws[:, :3])).as_matrix()
    information, _, chi2 = prior.rows_of_many(R, T.apply(CENTER + draws[:, 3:]), CENTER)
    at = prior.log_densities(information, chi2)
    one_by_one = [prior.log_density(T * perturbation(xi, CENTER), CENTER) for xi in draws[:100]]
    np.testing.assert_allclose(at[:100], one_by_one, rtol=1e-9)
    assert prior.log_density(T, CENTER, C) == pytest.approx(np.log(np.mean(np.exp(at))), abs=0.1)
    assert prior.log_density(T, CENTER, 1e-12 * C) == pytest.approx(prior.log_density(T, CENTER), abs=1e-6)


def test_data_and_prior_meet_where_their_information_says():
    """Against a dense Gaussian product: the data's mean is xi = 0, the prior's where its residual vanishes."""
    T, prior, _ = planar_prior(5)
    T = T * about(np.random.default_rng(1), turn=0.004, shift=0.02)
    C = np.diag([0.02, 0.01, 0.03, 0.1, 0.2, 0.15]) ** 2
    A, v, _ = prior.rows(T, CENTER)
    both, spread = prior.combined(T, CENTER, C)
    np.testing.assert_allclose(spread, np.linalg.inv(np.linalg.inv(C) + A), rtol=1e-8, atol=1e-14)
    xi = -np.linalg.inv(np.linalg.inv(C) + A) @ v
    np.testing.assert_allclose(both.as_matrix(), (T * perturbation(xi, CENTER)).as_matrix(), atol=1e-12)
    assert prior.rows(both, CENTER)[2] < prior.rows(T, CENTER)[2]
    alone, own = prior.taken_out(both, CENTER, spread)
    sd = np.sqrt(np.diag(C))
    np.testing.assert_allclose(own / np.outer(sd, sd), C / np.outer(sd, sd), atol=0.01)
    np.testing.assert_allclose(alone.as_matrix(), T.as_matrix(), atol=5e-4)
