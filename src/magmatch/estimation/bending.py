# SPDX-License-Identifier: BSD-3-Clause
"""How the drift of positions and orientations bends a path, as independent modes."""

from dataclasses import dataclass

import numpy as np
from scipy.linalg import svd

from magmatch.geometry import skew
from magmatch.typing import Covariance6, Matrix, Points

# Turn that comes with a shift of one metre, rad/m: what dead reckoning loses of both (0.6 deg with 10 cm).
TURN_PER_SHIFT = 0.1
# Modes kept: of a random walk, the variance of the k-th falls with its square.
N_MODES = 40


@dataclass(frozen=True, eq=False, slots=True)
class Bending:
    """Drift of two surveys at a rate of 1 m per sqrt(m), about its mean along the path, in two parts."""

    modes: np.ndarray  # (n, 6, m): turn (rad) and shift (m) of each point by independent errors of unit variance
    # (6, 6): covariance of the rigid motion about the path's centre that best follows the drift, rotation first: an
    # error of the frame, which no residual shows
    frame: Covariance6


def bending_of(positions: Points) -> Bending:
    """Random walks of position and of orientation, which carries all that follows around, of points on a path."""
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
    # Base and target drift alike.
    flat = np.sqrt(2) * (loads - loads.mean(axis=0)).reshape(6 * n, -1)
    rigid = _rigid_motions(positions)
    followed = np.linalg.lstsq(rigid, flat, rcond=None)[0]
    modes, strengths, _ = svd(flat - rigid @ followed, full_matrices=False, check_finite=False)
    kept = (modes[:, :N_MODES] * strengths[:N_MODES]).reshape(n, 6, -1)
    return Bending(np.asarray(kept), np.asarray(followed @ followed.T))


def _rigid_motions(positions: Points) -> Matrix:
    """Give the effect of a turn about the path's centre and a shift on turns and shifts of its points: (6 n, 6)."""
    lever = -skew(positions - positions.mean(axis=0))
    eye = np.broadcast_to(np.eye(3), lever.shape)
    rows = np.concatenate([np.concatenate([eye, 0 * eye], axis=2), np.concatenate([lever, eye], axis=2)], axis=1)
    return np.asarray(rows.reshape(6 * len(positions), 6))
