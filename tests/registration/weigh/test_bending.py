# SPDX-License-Identifier: BSD-3-Clause
"""Laws of the modes by which a path bends."""

import numpy as np
import pytest

from magmatch.geometry import skew
from magmatch.registration.weigh.bending_walk import TURN_PER_SHIFT, bending_of


@pytest.fixture(scope="module")
def path():
    t = np.linspace(0, 6, 60)
    return np.column_stack([2 * t, np.sin(t), 0.1 * t**2])


def rigid_motions(x):
    """What a turn about the middle and a shift do to the turns and shifts of points: (6 n, 6)."""
    lever, eye = -skew(x - x.mean(axis=0)), np.broadcast_to(np.eye(3), (len(x), 3, 3))
    rows = np.concatenate([np.concatenate([eye, 0 * eye], axis=2), np.concatenate([lever, eye], axis=2)], axis=1)
    return rows.reshape(6 * len(x), 6)


def test_no_mode_moves_the_path_as_a_rigid_body_does(path):
    modes = bending_of(path).modes.reshape(6 * len(path), -1)
    assert np.abs(rigid_motions(path).T @ modes).max() < 1e-8 * np.abs(modes).max() * len(path)


def test_modes_and_frame_have_the_covariances_of_what_two_random_walks_do(path):
    rng, x, n = np.random.default_rng(0), path, len(path)
    steps, middles = np.linalg.norm(np.diff(x, axis=0), axis=1), (x[1:] + x[:-1]) / 2
    turns, shifts = np.sqrt(steps)[:, None] * rng.standard_normal((2, 4000, n - 1, 3))
    turns *= TURN_PER_SHIFT
    # Each turn is about the middle of its step.
    moved = np.zeros((4000, n, 6))
    moved[:, 1:, :3] = np.cumsum(turns, axis=1)
    moved[:, 1:, 3:] = np.cumsum(shifts - np.cross(turns, middles), axis=1) + np.cross(moved[:, 1:, :3], x[1:])
    moved -= moved.mean(axis=1, keepdims=True)
    rigid, drifts, bending = rigid_motions(x), np.sqrt(2) * moved.reshape(4000, -1).T, bending_of(x)
    followed = np.linalg.lstsq(rigid, drifts, rcond=None)[0]
    # Drift is about its mean, so the frame turns alone.
    np.testing.assert_allclose(bending.frame[3:], 0, rtol=0, atol=1e-9)
    of_turns = bending.frame[:3, :3]
    np.testing.assert_allclose(of_turns, np.cov(followed[:3]), rtol=0, atol=0.1 * np.trace(of_turns) / 3)
    left = (drifts - rigid @ followed).var(axis=1)
    np.testing.assert_allclose((bending.modes**2).sum(axis=2).ravel(), left, rtol=0.15, atol=0.02 * left.max())


def test_a_path_twice_as_long_bends_more_by_its_shifts_and_still_more_by_its_turns(path):
    # Shifts grow with the square root of the path; turns too, and their arms with the path itself.
    small, more, large, larger = (
        np.sqrt((bending_of(scale * path).modes[:, 3:] ** 2).sum()) for scale in (1e-3, 2e-3, 1e3, 2e3)
    )
    assert more / small == pytest.approx(np.sqrt(2), rel=1e-3)
    assert larger / large == pytest.approx(np.sqrt(8), rel=1e-2)
