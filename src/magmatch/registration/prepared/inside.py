# SPDX-License-Identifier: BSD-3-Clause
"""A prior restricted to poses that put the target inside the base, since two surveys of one place overlap.

Only few poses put a long or flat target inside a corridor; a prior spread over all poses would penalise those that
are possible. Poses are drawn that put some point of the target on some point that the base knows. The probability
of drawing a pose is proportional to the share of the target that it puts inside, so the mean of ``weight / share``
estimates the integral of the weights, as a fraction of all rotations and all positions that the base knows.
"""

from collections.abc import Callable
from dataclasses import replace
from functools import lru_cache

import numpy as np
from scipy.spatial.transform import Rotation

from magmatch.compiled import compiled_ahead
from magmatch.estimation.cubes import even_choice
from magmatch.estimation.limits import FEW_POINTS, MOST_DRAWN
from magmatch.estimation.pose_prior import UP, PosePrior
from magmatch.registration.prepared.raster import RASTER, Raster, find_cell
from magmatch.typing import Points, Scalars, Tensors


def spread_inside(
    prior: PosePrior, raster: Raster, points: Points, log_weight: Callable[[Scalars], Scalars]
) -> PosePrior:
    """Spread a prior over poses that put the target inside the base.

    A prior about a rough pose is returned unchanged: it states where the target lies. ``points`` (n, 3), m, are
    spread evenly over the target, its model frame; ``log_weight`` is of a pose, by the share of the target that it
    puts inside.
    """
    known = np.argwhere(raster.sd >= 0)
    if prior.T_base_target is not None or not len(known) or not len(points):
        return prior
    chosen = points[even_choice(len(points), FEW_POINTS)]
    turns, uniform, normal = _draws()
    R = _turns(prior, turns, uniform[:, 0], normal)
    rows = (uniform[:, 1] * len(chosen)).astype(np.int64)
    corners = known[(uniform[:, 2] * len(known)).astype(np.int64)]
    places = raster.origin + (corners + uniform[:, 3:] - 0.5) * raster.spacing
    if prior.height is not None and prior.up_base is not None and prior.up_target is not None:
        height = chosen[rows] @ prior.up_target + prior.height + prior.height_sd * normal[:, 2]
        places = places + np.outer(height - places @ prior.up_base, prior.up_base)
    shares = np.zeros(len(R))
    _shares(raster, chosen, R, rows, places, shares)
    # One further draw counts as entirely inside, so that the sum is never zero.
    inside = np.append(shares[shares > 0], 1.0)
    total = (np.exp(log_weight(inside)) / inside).sum()
    return replace(prior, log_share_inside=float(np.log(total / (MOST_DRAWN + 1))))


@lru_cache(maxsize=1)
def _draws() -> tuple[Tensors, Points, Points]:
    """Random numbers, the same for all pairs: rotations (n, 3, 3), uniform (n, 6) and normal (n, 3) numbers."""
    rng = np.random.default_rng(0)
    turns = Rotation.random(MOST_DRAWN, random_state=rng).as_matrix()
    return turns, rng.random((MOST_DRAWN, 6)), rng.standard_normal((MOST_DRAWN, 3))


def _turns(prior: PosePrior, turns: Tensors, heading: Scalars, normal: Points) -> Tensors:
    """Rotations: arbitrary ones, or those about the vertical."""
    if prior.up_base is None or prior.up_target is None:
        return turns
    to_up, _ = Rotation.align_vectors(UP[None], prior.up_target[None])
    from_up, _ = Rotation.align_vectors(prior.up_base[None], UP[None])
    tilt = Rotation.from_rotvec(prior.gravity_sd * normal * np.array([1.0, 1.0, 0.0]))
    about_up = Rotation.from_rotvec(2 * np.pi * heading[:, None] * UP)
    return np.asarray((from_up * tilt * about_up * to_up).as_matrix())


@compiled_ahead(RASTER, "f8[:,::1], f8[:,:,::1], i8[::1], f8[:,::1], f8[::1]")
def _shares(raster, points, R, rows, places, out):  # type: ignore[no-untyped-def]
    """Share of the points inside; 0 if the placed point is not."""
    origin, spacing, values = raster
    n = len(points)
    for h in range(len(R)):
        if find_cell(values, origin, spacing, places[h, 0], places[h, 1], places[h, 2])[0] < 0:
            continue
        placed, count = rows[h], 0
        for k in range(n):
            x, y, z = places[h, 0], places[h, 1], places[h, 2]
            for c in range(3):
                d = points[k, c] - points[placed, c]
                x += R[h, 0, c] * d
                y += R[h, 1, c] * d
                z += R[h, 2, c] * d
            if find_cell(values, origin, spacing, x, y, z)[0] >= 0:
                count += 1
        out[h] = count / n
