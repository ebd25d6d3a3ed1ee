# SPDX-License-Identifier: BSD-3-Clause
"""How a path bends: random walks of position and of orientation, and what they leave of the frame."""

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from magmatch.estimation.model_prior import Turns
from magmatch.geometry import skew
from magmatch.typing import Covariance6, Matrix, Points, Vectors


@dataclass(frozen=True, eq=False, slots=True)
class Bending:
    """Drift of two surveys at a rate of 1 m per sqrt(m), about its mean along the path, in two parts."""

    turns: Turns
    shape: np.ndarray  # (n, 6 n, 6): covariance of each point's turn (rad) and shift (m) with those of all
    # (6, 6): covariance of the rigid motion about the path's centre that best follows the drift, rotation first: an
    # error of the frame, which no residual shows
    frame: Covariance6

    def turned(self, field: Vectors) -> np.ndarray:
        """Covariance (n, 3, n, 3) of the points' field (n, 3), T^2, by their turns alone."""
        by_turns = self.shape.reshape(len(field), len(field), 6, 6)[:, :, :3, :3]
        return np.asarray(np.einsum("nia,mnab,mjb->nimj", skew(field), by_turns, skew(field), optimize=True))


class WalkDrift(NamedTuple):
    """A drift that a walk may have: a model of its pose."""

    rate: float  # m/sqrt(m)
    bending: Bending

    @property
    def model(self) -> str:
        """Its name."""
        return f"drifts by {self.rate} m per root of a metre, {self.bending.turns.name}"


def bending_of(positions: Points, turns: Turns) -> Bending:
    """Random walks of position and of orientation, of points on a path."""
    n = len(positions)
    steps = np.linalg.norm(np.diff(positions, axis=0), axis=1)
    middles = (positions[1:] + positions[:-1]) / 2
    follows = (np.arange(n - 1)[None] < np.arange(n)[:, None]) * np.sqrt(steps)
    arms = skew((positions[:, None] - middles[None]).reshape(-1, 3)).reshape(n, n - 1, 3, 3)
    columns = []
    for e in np.eye(3):
        carried = -arms @ e * turns.carry_positions
        columns.append(np.concatenate([np.broadcast_to(e, carried.shape), carried], axis=2) * turns.per_shift)
        columns.append(np.broadcast_to(np.concatenate([np.zeros(3), e]), (n, n - 1, 6)))
    loads = np.moveaxis(np.concatenate([follows[:, :, None] * column for column in columns], axis=1), 1, 2)
    # Base and target drift alike.
    flat = np.sqrt(2) * (loads - loads.mean(axis=0)).reshape(6 * n, -1)
    rigid = _rigid_motions(positions)
    followed = np.linalg.lstsq(rigid, flat, rcond=None)[0]
    left = flat - rigid @ followed
    shape = np.ascontiguousarray((left @ left.T).reshape(6 * n, n, 6).swapaxes(0, 1))
    return Bending(turns, shape, np.asarray(followed @ followed.T))


def _rigid_motions(positions: Points) -> Matrix:
    """Give the effect of a turn about the path's centre and a shift on turns and shifts of its points: (6 n, 6)."""
    lever = -skew(positions - positions.mean(axis=0))
    eye = np.broadcast_to(np.eye(3), lever.shape)
    rows = np.concatenate([np.concatenate([eye, 0 * eye], axis=2), np.concatenate([lever, eye], axis=2)], axis=1)
    return np.asarray(rows.reshape(6 * len(positions), 6))
