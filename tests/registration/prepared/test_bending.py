# SPDX-License-Identifier: BSD-3-Clause
"""Laws of the modes by which a path bends."""

import numpy as np
import pytest

from magmatch.registration.prepared.bending import TURN_PER_SHIFT, bending_modes


@pytest.fixture(scope="module")
def path():
    t = np.linspace(0, 6, 60)
    return np.column_stack([2 * t, np.sin(t), 0.1 * t**2])


def test_no_mode_shifts_or_turns_the_path_on_average(path):
    modes = bending_modes(path)
    assert np.abs(modes.mean(axis=0)).max() < 1e-9 * np.abs(modes).max()


def test_modes_have_the_covariance_of_two_random_walks_about_their_means(path):
    rng, x, n = np.random.default_rng(0), path, len(path)
    steps, middles = np.linalg.norm(np.diff(x, axis=0), axis=1), (x[1:] + x[:-1]) / 2
    drawn = []
    for _ in range(4000):
        turns = TURN_PER_SHIFT * rng.standard_normal((n - 1, 3)) * np.sqrt(steps)[:, None]
        shifts = rng.standard_normal((n - 1, 3)) * np.sqrt(steps)[:, None]
        moved = np.zeros((n, 6))
        for k in range(n - 1):
            moved[k + 1 :, :3] += turns[k]
            moved[k + 1 :, 3:] += shifts[k] + np.cross(turns[k], x[k + 1 :] - middles[k])
        drawn.append((moved - moved.mean(axis=0)).ravel())
    expected, modes = 2 * np.cov(np.array(drawn).T), bending_modes(x).reshape(6 * n, -1)
    np.testing.assert_allclose(np.diag(modes @ modes.T), np.diag(expected), rtol=0.2, atol=0.02 * expected.max())


def test_a_path_twice_as_long_bends_more_by_its_shifts_and_still_more_by_its_turns(path):
    # Shifts grow with the square root of the path; turns too, and their arms with the path itself.
    small, more, large, larger = (
        np.sqrt((bending_modes(scale * path)[:, 3:] ** 2).sum()) for scale in (1e-3, 2e-3, 1e3, 2e3)
    )
    assert more / small == pytest.approx(np.sqrt(2), rel=1e-3)
    assert larger / large == pytest.approx(np.sqrt(8), rel=1e-2)
