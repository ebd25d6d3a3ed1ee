# SPDX-License-Identifier: BSD-3-Clause
"""What the halves of a target say of its pose: nothing of a rigid one, how it bends of one that drifts."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.integrate import quad
from scipy.spatial.transform import RigidTransform

from hand_made import Drawn, WeighedPose, prepared_map, some_field
from magmatch.estimation.path_noise import PathNoise
from magmatch.estimation.pose_prior import PosePrior
from magmatch.estimation.walk import Walk
from magmatch.geometry import perturbation, random_transform
from magmatch.registration.prepared.drift import Drift
from magmatch.registration.refine.refinement import refine
from magmatch.registration.weigh.bend import Bend, bend_of_map, bend_of_walk

NOISE = PathNoise(0.2e-6, 0.8, 0.1e-6, 0.1e-6, 1.0, 0.8, 0.005, 0.005, 3.0, spread=0.4, n_stretches=9)
# Turns and comes back, so that each half fixes its pose.
WALKED = np.linspace(0, 4 * np.pi, 60)
PATH = np.column_stack([0.15 * WALKED, 0.5 * np.sin(WALKED), 0.2 * np.cos(WALKED)])


def some_map(seed, positions):
    return prepared_map(some_field(seed), np.concatenate([positions + d for d in 0.2 * np.eye(3)]), length=0.8)


def walk_through(base, T_base_walk, positions=PATH):
    """Bins as the base's field has them."""
    field = base.posterior.evaluate(T_base_walk.apply(positions)).field @ T_base_walk.rotation.as_matrix()
    return Walk(RigidTransform.identity(), positions, field)


def bent(walk, xi, center):
    """Its second half as a walker has it who drifted by xi about a point: where it was, but told otherwise."""
    half, T = len(walk) // 2, perturbation(xi, center).inv()
    positions, field = walk.positions.copy(), walk.field.copy()
    positions[half:], field[half:] = T.apply(positions[half:]), T.rotation.apply(field[half:])
    return Walk(walk.T_survey_walk, positions, field)


def found(base, walk, T):
    return bend_of_walk(base, walk, T, NOISE, PosePrior(100.0))


@pytest.fixture(scope="module")
def place():
    T = random_transform(np.random.default_rng(4), 1.0)
    return some_map(3, T.apply(PATH)), T


def test_halves_of_a_rigid_walk_agree(place):
    base, T = place
    bend = found(base, walk_through(base, T), T)
    assert bend.half_chi2 < 1e-3
    assert bend.probability < 0.2


def test_a_bend_is_found_with_its_size(place):
    base, T = place
    xi = np.array([0.02, -0.03, 0.05, 0.03, -0.02, 0.04])
    bend = found(base, bent(walk_through(base, T), xi, PATH.mean(axis=0)), T)
    assert bend.probability > 0.999
    np.testing.assert_allclose(bend.xi, xi, atol=4e-3)
    # Less may be the halves' own errors.
    xi = 0.3 * np.sqrt(np.diag(bend.covariance))
    assert found(base, bent(walk_through(base, T), xi, PATH.mean(axis=0)), T).probability < 0.9


def test_a_pose_is_off_by_as_much_as_the_walk_bends_and_by_more_where_the_base_ends(place):
    base, T = place
    whole = found(base, walk_through(base, T), T)
    # Of a straight drift, half the difference at the ends: a third of the square on average.
    assert whole.reach == pytest.approx(np.sqrt(1 / 3), rel=0.05)
    beyond = np.concatenate([PATH, PATH + np.array([30.0, 0.0, 0.0])])
    part = found(base, walk_through(base, T, beyond), T)
    assert part.reach > 2 * whole.reach


def test_nothing_is_told_where_a_half_has_too_few_bins(place):
    base, T = place
    walk = walk_through(base, T)
    assert found(base, walk.part(np.arange(12)), T) is None


def as_map(walk, seed=0):
    """The walk's samples as those of a map that is never looked up: raster and posterior are elsewhere."""
    noise = 1e-7 * np.random.default_rng(seed).standard_normal(walk.field.shape)
    away = prepared_map(some_field(9), walk.positions + 1e3, length=0.3)
    return replace(away, samples=walk.positions, sample_field=walk.field + noise)


FINE = np.linspace(0, 4 * np.pi, 400)
FINE_PATH = np.column_stack([0.15 * FINE, 0.5 * np.sin(FINE), 0.2 * np.cos(FINE)])
T_THERE = random_transform(np.random.default_rng(4), 1.0)


def a_base(error=1e-8):
    """A map along the path, whose own error is a constant field of some size (T)."""
    rng = np.random.default_rng(5)
    base, draws = some_map(3, T_THERE.apply(FINE_PATH)), [error * rng.standard_normal(3) for _ in range(8)]
    return replace(base, field_map=Drawn(base.posterior), draws=lambda: draws, correlation_length=0.3)


def bend_as_map(base, target):
    prior = PosePrior(100.0)
    pose = refine(base, target, T_THERE, prior, "none", np.random.default_rng(0), -1)
    return bend_of_map(base, target, pose, prior, "none", 0)


def walk_that_bends(base, xi):
    return bent(walk_through(base, T_THERE, FINE_PATH), np.asarray(xi), FINE_PATH.mean(axis=0))


XI = np.array([0.02, -0.03, 0.05, 0.03, -0.02, 0.04])


@pytest.mark.parametrize("size", [0.0, 1.0])
def test_samples_of_a_map_bend_as_a_walk_does(size):
    base = a_base()
    bend = bend_as_map(base, as_map(walk_that_bends(base, size * XI)))
    assert (bend.probability > 0.99) == (size > 0)
    np.testing.assert_allclose(bend.xi, size * XI, atol=6e-3)


def test_what_the_base_does_not_know_between_its_samples_and_what_positions_drift_by_may_bend_a_map_too():
    base = a_base()
    walk = walk_that_bends(base, XI)
    known, vague = (bend_as_map(one, as_map(walk)) for one in (base, a_base(error=3e-6)))
    assert vague.half_chi2 < known.half_chi2 / 10
    one = Drift(0.1, 0.1, np.zeros(len(FINE_PATH), dtype=np.int64), np.ones((1, 1)))
    walk = walk_that_bends(base, [0, 0, 0, *XI[3:]])
    assert bend_as_map(base, as_map(walk)).probability > 0.99
    stated = bend_as_map(base, replace(as_map(walk), drift=one))
    assert np.sqrt(np.diag(stated.covariance)[3:]).min() > 0.9 * np.sqrt(2) * 0.1
    assert stated.probability < 0.99


def test_samples_in_no_order_have_no_halves():
    base, order = a_base(), np.random.default_rng(0).permutation(len(FINE_PATH))
    assert bend_as_map(base, as_map(walk_through(base, T_THERE, FINE_PATH[order]))) is None


@given(st.integers(0, 10_000))
def test_what_a_bend_does_to_a_point_is_the_same_in_any_axes_and_about_any_centre(seed):
    rng = np.random.default_rng(seed)
    xi, center, point = rng.normal(size=6), *rng.normal(size=(2, 3))
    A = rng.normal(size=(6, 6))
    bend, T = Bend(xi, center, A @ A.T, 1.7), random_transform(rng)
    seen = bend.seen_from(T)
    size = 1.7 * np.sqrt(bend.share)
    moved = size * (xi[3:] + np.cross(xi[:3], point - center))
    for found, R, p in ((bend, np.eye(3), point), (seen, T.rotation.as_matrix(), T.apply(point))):
        spread = found.spread(p)
        np.testing.assert_allclose(spread[3:, 3:], R @ np.outer(moved, moved) @ R.T, atol=1e-9)
        np.testing.assert_allclose(spread[:3, :3], size**2 * R @ np.outer(xi[:3], xi[:3]) @ R.T, atol=1e-9)
        assert not spread[:3, 3:].any()
    assert seen.half_chi2 == pytest.approx(bend.half_chi2, rel=1e-6)


@pytest.mark.parametrize("c", [1e-6, 3.0, 300.0])
def test_the_evidence_of_a_bend_of_any_size_is_its_integral(c):
    xi = np.sqrt(2 * c / 6) * np.ones(6)
    bend = Bend(xi, np.zeros(3), np.eye(6), 1.0)
    mass, _ = quad(lambda u: 0.5 * u**2.5 * np.exp(-c * u), 0, 1, epsabs=0)
    kept, _ = quad(lambda u: 0.5 * (1 - u) * u**2.5 * np.exp(-c * u), 0, 1, epsabs=0)
    assert bend.log_ratio == pytest.approx(c + np.log(mass), rel=1e-6)
    assert bend.share == pytest.approx(kept / mass, rel=1e-6)


@given(c=st.floats(0.01, 200), e=st.floats(1, 500))
def test_rigid_and_bent_share_the_evidence_for_the_place(c, e):
    bend = Bend(np.sqrt(2 * c / 6) * np.ones(6), np.zeros(3), np.eye(6), 1.0)
    rigid, bent = bend.among(WeighedPose(log_evidence=e))
    assert np.logaddexp(rigid.log_evidence, bent.log_evidence) == pytest.approx(e)
    assert bent.log_evidence - rigid.log_evidence == pytest.approx(bend.log_ratio)
    assert rigid.model != bent.model
