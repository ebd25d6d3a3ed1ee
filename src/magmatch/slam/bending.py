# SPDX-License-Identifier: BSD-3-Clause
"""The errors of dead reckoning rotate and shift the points of a path relative to one of them."""

import numpy as np

from magmatch.geometry import path_walked, skew
from magmatch.preparation.odometry.drift import OdometryConfig
from magmatch.typing import Matrix, Points


def bend(positions: Points, about: int, odometry: OdometryConfig, *, upright: bool, planar: bool) -> np.ndarray:
    """Give the effect of m errors of unit variance on each point of a path: (n, 6, m), turn (rad), then shift (m).

    Between neighbouring points heading and position take a random step; errors of scale and turn rate are constant
    along the whole path. The point ``about`` stays; ``upright``: only the heading drifts; ``planar``: the height does
    not.
    """
    n = len(positions)
    steps = np.linalg.norm(np.diff(positions, axis=0), axis=1)
    middles = (positions[1:] + positions[:-1]) / 2
    i, u = np.arange(n)[:, None], np.arange(n - 1)[None, :]
    # Which steps lie between the point that stays and another: those before it act the other way round.
    between = ((u >= about) & (u < i)).astype(float) - ((u < about) & (u >= i)).astype(float)
    axes = np.eye(3)
    turning, moving = (axes[2:] if upright else axes), (axes[:2] if planar else axes)
    arms = skew((positions[:, None] - middles[None]).reshape(-1, 3)).reshape(n, n - 1, 3, 3)
    columns = []
    for e in turning:
        # A turn by e at a step carries all that follows around it.
        carried = -arms @ e
        loads = np.concatenate([np.broadcast_to(e, carried.shape), carried], axis=2) * between[:, :, None]
        columns.append(np.moveaxis(loads * (odometry.rotation_sd * np.sqrt(steps))[None, :, None], 1, 2))
    for e in moving:
        loads = np.concatenate([np.zeros(3), e])[None, None] * between[:, :, None]
        columns.append(np.moveaxis(loads * (odometry.translation_sd * np.sqrt(steps))[None, :, None], 1, 2))
    columns.append(lasting_errors(positions, about, upright=upright) * [odometry.scale_sd, odometry.turn_rate_sd])
    return np.concatenate(columns, axis=2)


def lasting_errors(positions: Points, about: int, *, upright: bool) -> np.ndarray:
    """Give the effect of unit errors of scale (a share) and turn rate (rad/m, about z) on each point: (n, 6, 2)."""
    n = len(positions)
    found = np.zeros((n, 6, 2))
    found[:, 3:, 0] = positions - positions[about]
    if upright:
        walked = path_walked(positions)
        middles = (positions[1:] + positions[:-1]) / 2
        # The integral of e_z x (p - p_u) over the path between.
        moment = np.concatenate([np.zeros((1, 3)), np.cumsum(middles * np.diff(walked)[:, None], axis=0)])
        arm = positions * (walked - walked[about])[:, None] - (moment - moment[about])
        found[:, 2, 1] = walked - walked[about]
        found[:, 3:, 1] = np.cross([0.0, 0.0, 1.0], arm)
    return found


def turned(loads: np.ndarray, R: Matrix) -> np.ndarray:
    """Express turns and shifts in other axes: ``R v`` for each."""
    return np.concatenate([R @ loads[:, :3], R @ loads[:, 3:]], axis=1)
