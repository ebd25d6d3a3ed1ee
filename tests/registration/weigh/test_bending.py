# SPDX-License-Identifier: BSD-3-Clause
"""Laws of how a path bends."""

import numpy as np
import pytest

from magmatch.estimation.model_prior import TURNS
from magmatch.geometry import skew
from magmatch.registration.weigh.bending import bending_of


@pytest.fixture(scope="module")
def path():
    t = np.linspace(0, 6, 60)
    return np.column_stack([2 * t, np.sin(t), 0.1 * t**2])


def rigid_motions(x):
    """What a turn about the middle and a shift do to the turns and shifts of points: (6 n, 6)."""
    lever, eye = -skew(x - x.mean(axis=0)), np.broadcast_to(np.eye(3), (len(x), 3, 3))
    rows = np.concatenate([np.concatenate([eye, 0 * eye], axis=2), np.concatenate([lever, eye], axis=2)], axis=1)
    return rows.reshape(6 * len(x), 6)


def covariance(bending):
    """Of all turns and shifts, point by point: (6 n, 6 n)."""
    return bending.shape.swapaxes(0, 1).reshape(2 * (6 * len(bending.shape),))


@pytest.fixture(params=TURNS, ids=lambda turns: turns.name)
def turns(request):
    return request.param


def test_bending_moves_no_path_as_a_rigid_body_does(path, turns):
    C = covariance(bending_of(path, turns))
    assert np.abs(rigid_motions(path).T @ C).max() < 1e-8 * np.abs(C).max() * len(path)


def test_shape_and_frame_have_the_covariances_of_what_two_random_walks_do(path, turns):
    rng, x, n = np.random.default_rng(0), path, len(path)
    steps, middles = np.linalg.norm(np.diff(x, axis=0), axis=1), (x[1:] + x[:-1]) / 2
    angles, shifts = np.sqrt(steps)[:, None] * rng.standard_normal((2, 4000, n - 1, 3))
    angles *= turns.per_shift
    moved = np.zeros((4000, n, 6))
    moved[:, 1:, :3], moved[:, 1:, 3:] = np.cumsum(angles, axis=1), np.cumsum(shifts, axis=1)
    if turns.carry_positions:  # each turn is about the middle of its step
        moved[:, 1:, 3:] -= np.cumsum(np.cross(angles, middles), axis=1) - np.cross(moved[:, 1:, :3], x[1:])
    moved -= moved.mean(axis=1, keepdims=True)
    rigid, drifts, bending = rigid_motions(x), np.sqrt(2) * moved.reshape(4000, -1).T, bending_of(x, turns)
    followed = np.linalg.lstsq(rigid, drifts, rcond=None)[0]
    # Drift is about its mean, so the frame turns alone.
    np.testing.assert_allclose(bending.frame[3:], 0, rtol=0, atol=1e-9)
    of_turns = bending.frame[:3, :3]
    np.testing.assert_allclose(of_turns, np.cov(followed[:3]), rtol=0, atol=0.1 * np.trace(of_turns) / 3)
    drawn, found = np.cov(drifts - rigid @ followed), covariance(bending)
    sds = np.sqrt(np.outer(np.diag(found), np.diag(found)))
    np.testing.assert_allclose(drawn / sds, found / sds, rtol=0, atol=0.12)


def test_a_path_twice_as_long_bends_more_by_its_shifts_and_still_more_by_the_turns_that_carry_it(path):
    # Shifts grow with the square root of the path; turns too, and their arms with the path itself.
    def shift_of(scale, turns):
        return np.sqrt(
            np.trace(
                covariance(bending_of(scale * path, turns)).reshape(60, 6, 60, 6)[:, 3:, :, 3:].reshape(180, 180)
            )
        )

    for turns in TURNS:
        small, more, large, larger = (shift_of(scale, turns) for scale in (1e-3, 2e-3, 1e4, 2e4))
        assert more / small == pytest.approx(np.sqrt(2), rel=1e-3)
        assert larger / large == pytest.approx(np.sqrt(8 if turns.carry_positions else 2), rel=1e-2)


def test_turns_change_the_field_across_it_alone(path):
    field = np.tile([0.0, 0.0, 50e-6], (len(path), 1))
    C = bending_of(path, TURNS[0]).turned(field)
    assert np.abs(C[:, 2]).max() < 1e-12 * np.abs(C).max()
    swings = covariance(bending_of(path, TURNS[0])).reshape(60, 6, 60, 6)[:, 0, :, 0]
    np.testing.assert_allclose(C[:, 1, :, 1], 50e-6**2 * swings, rtol=1e-9, atol=1e-20)
