# SPDX-License-Identifier: BSD-3-Clause
"""How far a walk bends: the difference between its halves' poses, which a rigid pose cannot follow."""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from scipy.linalg import block_diag
from scipy.spatial.transform import RigidTransform
from scipy.special import chdtri

from magmatch.geometry import adjoint, path_walked, rotation_matrix
from magmatch.registration.prepared.path_noise import PathNoise
from magmatch.registration.prepared.pose_prior import PosePrior
from magmatch.registration.prepared.prepared_map import PreparedMap
from magmatch.registration.prepared.walk import Walk
from magmatch.registration.weigh.line_evidence import LineConfig, LineEvidence, weigh_walk
from magmatch.typing import Covariance6, Indices, Matrix, Vector3

DRIFTS = "the target's positions or orientations drift"
REMEDY = "register shorter pieces, or correct the walk with magmatch slam"


@dataclass(frozen=True, eq=False, slots=True)
class Bend:
    """The difference between the poses of the two halves of a walk's covered part.

    Attributes
    ----------
    xi : (6,) array
        From the first half's pose to the second's, rotation first (rad, m).
    center : (3,) array, m
        Point about which; both in the walk's axes.
    covariance : (6, 6) array
        Of xi, the sum of both halves' covariances.
    reach : float
        Root mean square distance along the path, of all the walk from the middle of the covered part, in the distance
        between the halves' middles.
    """

    xi: np.ndarray
    center: Vector3
    covariance: Matrix
    reach: float

    @property
    def chi2(self) -> float:
        """Chi-square statistic, with 6 degrees of freedom if the walk is rigid."""
        return float(self.xi @ np.linalg.solve(self.covariance, self.xi))

    def is_sure(self, probability: float) -> bool:
        """Whether a rigid walk can be rejected with this probability."""
        return self.chi2 > float(chdtri(6, 1 - probability))

    def seen_from(self, T_survey_walk: RigidTransform) -> "Bend":
        """The same in the survey's axes."""
        R = np.kron(np.eye(2), rotation_matrix(T_survey_walk))
        return Bend(R @ self.xi, T_survey_walk.apply(self.center), R @ self.covariance @ R.T, self.reach)

    def spread(self, center: Vector3) -> Covariance6:
        """Mean square error of a pose about a point, over the walk, if all of it drifts at this rate.

        Rotation and translation need not be correlated as they are between the halves.
        """
        turn, shift = np.split(
            self.reach * adjoint(RigidTransform.from_translation(self.center - center)) @ self.xi, 2
        )
        return np.asarray(block_diag(np.outer(turn, turn), np.outer(shift, shift)))

    def __str__(self) -> str:
        return (
            f"{DRIFTS}: the halves of what the base covers fit best {np.linalg.norm(self.xi[3:]):.1f} m and "
            f"{np.degrees(np.linalg.norm(self.xi[:3])):.0f} deg apart; {REMEDY}"
        )


def weigh_halves(
    walk: Walk, rows: Indices, weigh: Callable[[Walk], list[LineEvidence]]
) -> list[tuple[Indices, LineEvidence]]:
    """Rows and best pose of each half of some bins; fewer than two if a half has no pose."""
    return [(half, best) for half in np.array_split(rows, 2) for best in weigh(walk.part(half))[:1]]


def bend_of(
    base: PreparedMap,
    walk: Walk,
    T_base_walk: RigidTransform,
    noise: PathNoise,
    length: float,
    prior: PosePrior,
    config: LineConfig,
) -> Bend | None:
    """Refine the halves of the covered part from the pose of the whole; None if either has too few bins."""
    is_covered = base.raster.lookup(T_base_walk.apply(walk.positions))[3]

    def weigh(half: Walk) -> list[LineEvidence]:
        return weigh_walk(base, half, [T_base_walk], noise, length, prior, config)

    found = weigh_halves(walk, np.flatnonzero(is_covered), weigh)
    if len(found) < 2:
        return None
    rows, halves = zip(*found, strict=True)
    center, total = walk.positions[is_covered].mean(axis=0), np.zeros((6, 6))
    for half in halves:
        M = adjoint(RigidTransform.from_translation(half.center - center))
        total += M @ half.covariance @ M.T
    first, second = (T_base_walk.inv() * half.T_base_target for half in halves)
    turn = second.rotation.as_rotvec() - first.rotation.as_rotvec()
    walked = path_walked(walk.positions)
    along = walked - walked[is_covered].mean()
    between = float(np.diff([walked[part].mean() for part in rows])[0])
    xi = np.concatenate([turn, second.apply(center) - first.apply(center)])
    return Bend(xi, center, total, float(np.sqrt((along**2).mean())) / between)
