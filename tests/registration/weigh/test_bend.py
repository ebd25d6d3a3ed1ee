# SPDX-License-Identifier: BSD-3-Clause
"""What the halves of a walk say of its pose: nothing of a rigid one, how it bends of one that drifts."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.spatial.transform import RigidTransform

from hand_made import prepared_map, some_field
from magmatch.geometry import perturbation, random_transform
from magmatch.registration.prepared.path_noise import PathNoise
from magmatch.registration.prepared.pose_prior import PosePrior
from magmatch.registration.prepared.walk import Walk
from magmatch.registration.weigh.bend import Bend, bend_of
from magmatch.registration.weigh.line_evidence import LineConfig

NOISE = PathNoise(0.2e-6, 0.8, 0.1e-6, 0.1e-6, 1.0, 0.8, 0.005, 0.005, 3.0, spread=0.4, n_stretches=9)
# Turns and comes back, so that each half fixes its pose.
WALKED = np.linspace(0, 4 * np.pi, 60)
PATH = np.column_stack([0.15 * WALKED, 0.5 * np.sin(WALKED), 0.2 * np.cos(WALKED)])


def some_map(seed, positions):
    return prepared_map(some_field(seed), np.concatenate([positions + d for d in 0.2 * np.eye(3)]))


def walk_through(base, T_base_walk, positions=PATH):
    """Bins as the base's field has them."""
    field = base.posterior.evaluate(T_base_walk.apply(positions)).field @ T_base_walk.rotation.as_matrix()
    return Walk(RigidTransform.identity(), positions, field, np.ones(len(positions)))


def bent(walk, xi, center):
    """Its second half as a walker has it who drifted by xi about a point: where it was, but told otherwise."""
    half, T = len(walk) // 2, perturbation(xi, center).inv()
    positions, field = walk.positions.copy(), walk.field.copy()
    positions[half:], field[half:] = T.apply(positions[half:]), T.rotation.apply(field[half:])
    return Walk(walk.T_survey_walk, positions, field, walk.counts)


def found(base, walk, T):
    return bend_of(base, walk, T, NOISE, 0.8, PosePrior(100.0), LineConfig())


@pytest.fixture(scope="module")
def place():
    T = random_transform(np.random.default_rng(4), 1.0)
    return some_map(3, T.apply(PATH)), T


def test_halves_of_a_rigid_walk_agree(place):
    base, T = place
    bend = found(base, walk_through(base, T), T)
    assert bend.chi2 < 1e-3
    assert not bend.is_sure(0.5)


def test_a_bend_is_found_with_its_size(place):
    base, T = place
    xi = np.array([0.02, -0.03, 0.05, 0.03, -0.02, 0.04])
    bend = found(base, bent(walk_through(base, T), xi, PATH.mean(axis=0)), T)
    assert bend.is_sure(0.999)
    np.testing.assert_allclose(bend.xi, xi, atol=4e-3)
    # Less may be the halves' own errors.
    xi = 0.3 * np.sqrt(np.diag(bend.covariance))
    assert not found(base, bent(walk_through(base, T), xi, PATH.mean(axis=0)), T).is_sure(0.9)


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


@given(st.integers(0, 10_000))
def test_what_a_bend_does_to_a_point_is_the_same_in_any_axes_and_about_any_centre(seed):
    rng = np.random.default_rng(seed)
    xi, center, point = rng.normal(size=6), *rng.normal(size=(2, 3))
    A = rng.normal(size=(6, 6))
    bend, T = Bend(xi, center, A @ A.T, 1.7), random_transform(rng)
    seen = bend.seen_from(T)
    moved = 1.7 * (xi[3:] + np.cross(xi[:3], point - center))
    for found, R, p in ((bend, np.eye(3), point), (seen, T.rotation.as_matrix(), T.apply(point))):
        spread = found.spread(p)
        np.testing.assert_allclose(spread[3:, 3:], R @ np.outer(moved, moved) @ R.T, atol=1e-9)
        np.testing.assert_allclose(spread[:3, :3], 1.7**2 * R @ np.outer(xi[:3], xi[:3]) @ R.T, atol=1e-9)
        assert not spread[:3, 3:].any()
    assert seen.chi2 == pytest.approx(bend.chi2, rel=1e-6)
