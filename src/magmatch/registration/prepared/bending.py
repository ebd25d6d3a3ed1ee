# SPDX-License-Identifier: BSD-3-Clause
"""How the drift of positions and orientations bends a path, as independent modes."""

import numpy as np
from scipy.linalg import svd

from magmatch.geometry import skew
from magmatch.typing import Points

# Rates at which surveys may drift, m per sqrt(m) walked, equally likely: from a SLAM's own correction to dead
# reckoning.
RATES = (0.02, 0.05, 0.1, 0.2)
# Turn that comes with a shift of one metre, rad/m: what dead reckoning loses of both (0.6 deg with 10 cm).
TURN_PER_SHIFT = 0.1
# Modes kept: of a random walk, the variance of the k-th falls with its square.
N_MODES = 40


def bending_modes(positions: Points) -> np.ndarray:
    """Effect of independent errors of unit variance on each point of a path: (n, 6, m), turn (rad), shift (m).

    At a rate of 1 m per sqrt(m): a random walk of the position, and one of the orientation, which carries all that
    follows around; both about their means, which the pose takes up. Base and target drift alike, so each mode counts
    for both.
    """
    n = len(positions)
    steps = np.linalg.norm(np.diff(positions, axis=0), axis=1)
    middles = (positions[1:] + positions[:-1]) / 2
    follows = (np.arange(n - 1)[None] < np.arange(n)[:, None]) * np.sqrt(steps)
    arms = skew((positions[:, None] - middles[None]).reshape(-1, 3)).reshape(n, n - 1, 3, 3)
    columns = []
    for e in np.eye(3):
        carried = -arms @ e
        columns.append(np.concatenate([np.broadcast_to(e, carried.shape), carried], axis=2) * TURN_PER_SHIFT)
        columns.append(np.broadcast_to(np.concatenate([np.zeros(3), e]), (n, n - 1, 6)))
    loads = np.moveaxis(np.concatenate([follows[:, :, None] * column for column in columns], axis=1), 1, 2)
    flat = np.sqrt(2) * (loads - loads.mean(axis=0)).reshape(6 * n, -1)
    modes, strengths, _ = svd(flat, full_matrices=False, check_finite=False)
    return np.asarray((modes[:, :N_MODES] * strengths[:N_MODES]).reshape(n, 6, -1))
