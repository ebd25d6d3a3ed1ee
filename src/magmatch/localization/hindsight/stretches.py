# SPDX-License-Identifier: BSD-3-Clause
"""Stretches of a log followed in one direction, and those that the rest of the log contradicts.

A first fix is the best of very many starts, in a map whose errors are known by their spread only: what was fixed by
chance is contradicted by what follows. So a stretch that ended in a contradiction, or that has not been put to the
test, is believed only as far as the other direction, which found the body elsewhere in the log, agrees.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.spatial.transform import RigidTransform

from magmatch.geometry import transform_from_product
from magmatch.localization.estimate import LocalizerStatus, PoseEstimate
from magmatch.typing import COVARIANCE, POSE, Mask, Scalars

# Squared distance (chi^2 of six, one in 10,000) from which on two estimates contradict each other.
CONTRADICTION = 27.9
NONE = (np.zeros(0, POSE), np.zeros(0, COVARIANCE))


@dataclass(frozen=True, slots=True)
class TrustedSpan:
    """Rows ``first`` to ``last`` (inclusive), in the direction of travel: one place, trusted throughout."""

    first: int
    last: int
    is_contradicted: bool  # by what follows it at once

    @property
    def rows(self) -> slice:
        """Give the samples as an index."""
        return slice(self.first, self.last + 1)


def stretches(estimates: Sequence[PoseEstimate]) -> list[TrustedSpan]:
    """Stretches in which poses are stated; a pose that only became too uncertain contradicts nothing."""
    found, first, last = [], -1, len(estimates) - 1
    for n, e in enumerate(estimates):
        if e.is_stated and first < 0:
            first = n
        if first >= 0 and (n == last or not estimates[n + 1].is_stated or estimates[n + 1].map != e.map):
            found.append(TrustedSpan(first, n, n < last and not estimates[n + 1].is_place_known))
            first = -1
    return found


def agreement(a: Sequence[PoseEstimate], b: Sequence[PoseEstimate]) -> tuple[Mask, Mask]:
    """Tell where both directions state a pose, and where these agree: (n,) each."""
    both = np.array([x.is_stated and y.is_stated for x, y in zip(a, b, strict=True)], dtype=np.bool_)
    agree = both & [x.map == y.map for x, y in zip(a, b, strict=True)]
    rows = np.flatnonzero(agree).tolist()
    there, back = stacked([a[n] for n in rows]), stacked([b[n] for n in rows])
    xi = offsets(there[0], back[0])
    agree[rows] = (xi * np.linalg.solve(there[1] + back[1], xi[..., None])[..., 0]).sum(axis=1) <= CONTRADICTION
    return both, agree


def stacked(stated: Sequence[PoseEstimate]) -> tuple[RigidTransform, np.ndarray]:
    """Stated poses ``T_map_body`` (m,) and their covariances (m, 6, 6)."""
    found = [(e.matrix, e.covariance) for e in stated if e.matrix is not None and e.covariance is not None]
    matrices, covariances = (np.array(column) for column in zip(*found, strict=True)) if found else NONE
    return transform_from_product(matrices), covariances


def offsets(T_map_a: RigidTransform, T_map_b: RigidTransform) -> np.ndarray:
    """Twists (m, 6) from some poses to others."""
    xi: np.ndarray = (T_map_a.inv() * T_map_b).as_exp_coords()
    return xi


def believed(estimates: Sequence[PoseEstimate], both: Mask, agree: Mask, steps: Scalars, tested: float) -> Mask:
    """Rows whose poses stand, (n,), of estimates in the direction of travel; ``steps``: path from the row before (m).

    Where both directions state poses and mostly disagree, one of the stretches is wrong, and nothing says which. One
    that ended within the path ``tested`` (m) counts up to where the other direction agrees; so does one that ended in
    a contradiction, or up to that path before its end if it had stood before that. Only path in the map counts.
    """
    walked = np.cumsum(np.where([e.status is LocalizerStatus.DEAD_RECKONING for e in estimates], 0.0, steps))
    stands = np.zeros(len(estimates), dtype=np.bool_)
    for one in stretches(estimates):
        met, agreed = both[one.rows], agree[one.rows]
        if one.is_contradicted:
            # The contradiction began within the path by which a place is doubted; what stood before that still does.
            back = walked[one.last] - walked[one.rows]
            if back[0] >= 2 * tested and (not met.any() or agreed.sum() >= 0.5 * met.sum()):
                stands[one.rows] = back >= tested
        is_tested = walked[one.last] - walked[one.first] >= tested and not one.is_contradicted
        if agreed.any() and not is_tested:
            stands[one.first : one.first + int(np.flatnonzero(agreed)[-1]) + 1] = True
        elif is_tested and (not met.any() or agreed.sum() >= 0.5 * met.sum()):
            stands[one.rows] = True
    return stands
