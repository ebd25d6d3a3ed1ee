# SPDX-License-Identifier: BSD-3-Clause
"""How far a target bends along its path: the difference between its halves' poses, which no rigid pose follows."""

from dataclasses import dataclass, replace
from typing import TypeVar

import numpy as np
from scipy.linalg import block_diag
from scipy.spatial.transform import RigidTransform
from scipy.special import expit, gammainc, gammaln

from magmatch.estimation.path_noise import PathNoise
from magmatch.estimation.pose_prior import PosePrior
from magmatch.estimation.walk import Walk
from magmatch.field.folds import has_path_order
from magmatch.geometry import adjoint, path_walked, rotation_matrix
from magmatch.registration.prepared.prepared_map import PreparedMap, common_length
from magmatch.registration.refine.refinement import RefinedPose, refine
from magmatch.registration.refine.sensors import SensorMode
from magmatch.registration.weigh.covariance import drift_covariance, enclosing, joint_covariance, map_covariance
from magmatch.registration.weigh.evidence import PoseEvidence
from magmatch.registration.weigh.refine_and_weigh_walk import LineEvidence, weigh_walk
from magmatch.typing import Covariance6, Indices, Mask, Matrix, Points, Vector3

W = TypeVar("W", PoseEvidence, LineEvidence)

EPS = float(np.finfo(float).eps)
DRIFTS = "the target's positions or orientations drift"
NO_ROWS = np.zeros(0, dtype=np.int64)
REMEDY = "register shorter pieces, or correct the walk with magmatch slam"


@dataclass(frozen=True, eq=False, slots=True)
class Bend:
    """The difference between the poses of the two halves of a walk's covered part."""

    xi: np.ndarray  # (6,): from the first half's pose to the second's, rotation first (rad, m)
    center: Vector3  # (3,), m: point about which; both in the walk's axes
    covariance: Matrix  # (6, 6): of xi, the sum of both halves' covariances
    # Root mean square distance along the path, of all the walk from the middle of the covered part, in the distance
    # between the halves' middles
    reach: float

    @property
    def half_chi2(self) -> float:
        """Half of the chi-square statistic, which has 6 degrees of freedom if the walk is rigid."""
        return float(self.xi @ np.linalg.solve(self.covariance, self.xi)) / 2

    @property
    def log_ratio(self) -> float:
        """Log evidence of a walk that bends over that of a rigid one, nats.

        A bend is normal, with the covariance of the halves' difference times g, and 1 / (1 + g) = u has the density
        1 / (2 sqrt(u)) (F. Liang et al., Journal of the American Statistical Association 103(481), 2008): a bend may
        be of any size. Over u is integrated: ``u^3 exp(c (1 - u))``, c half of the chi-square.
        """
        c, a = max(self.half_chi2, EPS), len(self.xi) / 2 + 0.5
        return float(c - np.log(2) + np.log(gammainc(a, c)) + gammaln(a) - a * np.log(c))

    @property
    def probability(self) -> float:
        """Probability that the walk bends, by its halves alone, if beforehand it is as likely as not."""
        return float(expit(self.log_ratio))

    @property
    def share(self) -> float:
        """Share of the halves' difference that is the bend's, not noise: the posterior mean of 1 - u."""
        c, a = max(self.half_chi2, EPS), len(self.xi) / 2 + 0.5
        return float(1 - a / c * gammainc(a + 1, c) / gammainc(a, c))

    def among(self, pose: W) -> tuple[W, W]:
        """The hypotheses that take a rigid pose's place: rigid, and of a target that bends.

        Both share the evidence for the place: halves of a wrong pose differ, too.
        """
        both = float(np.logaddexp(0, self.log_ratio))
        rigid, bent = (
            replace(pose, model=model, log_evidence=pose.log_evidence + more, attainable=pose.attainable + more)
            for model, more in ((pose.model, -both), (f"{pose.model}, bends", self.log_ratio - both))
        )
        return rigid, bent

    def seen_from(self, T_survey_walk: RigidTransform) -> "Bend":
        """Express it in the survey's axes."""
        R = np.kron(np.eye(2), rotation_matrix(T_survey_walk))
        return Bend(R @ self.xi, T_survey_walk.apply(self.center), R @ self.covariance @ R.T, self.reach)

    def spread(self, center: Vector3) -> Covariance6:
        """Mean square error of a pose about a point, over the walk, if all of it drifts at this rate.

        Rotation and translation need not be correlated as they are between the halves.
        """
        size = self.reach * np.sqrt(self.share)
        turn, shift = np.split(size * adjoint(RigidTransform.from_translation(self.center - center)) @ self.xi, 2)
        return np.asarray(block_diag(np.outer(turn, turn), np.outer(shift, shift)))

    def __str__(self) -> str:
        return (
            f"{DRIFTS}: the halves of what the base covers fit best {np.linalg.norm(self.xi[3:]):.2g} m and "
            f"{np.degrees(np.linalg.norm(self.xi[:3])):.0f} deg apart; {REMEDY}"
        )


@dataclass(frozen=True, eq=False, slots=True)
class Half:
    """One half of the covered part, refined by itself."""

    rows: Indices  # (k,) ints: of the walk's positions
    T_base_walk: RigidTransform
    center: Vector3  # (3,), m: point about which the covariance is stated, walk's axes
    covariance: Covariance6  # (6, 6): of xi in ``T Exp(xi)`` about the centre


def bend_between(T_base_walk: RigidTransform, positions: Points, is_covered: Mask, halves: list[Half]) -> Bend | None:
    """The bend of a walk about the pose of the whole; None unless both halves have a pose."""
    if len(halves) < 2:
        return None
    center, total = positions[is_covered].mean(axis=0), np.zeros((6, 6))
    for half in halves:
        M = adjoint(RigidTransform.from_translation(half.center - center))
        total += M @ half.covariance @ M.T
    first, second = (T_base_walk.inv() * half.T_base_walk for half in halves)
    turn = second.rotation.as_rotvec() - first.rotation.as_rotvec()
    walked = path_walked(positions)
    along = walked - walked[is_covered].mean()
    between = float(np.diff([walked[half.rows].mean() for half in halves])[0])
    xi = np.concatenate([turn, second.apply(center) - first.apply(center)])
    return Bend(xi, center, total, float(np.sqrt((along**2).mean())) / between)


def bend_of_walk(
    base: PreparedMap,
    walk: Walk,
    T_base_walk: RigidTransform,
    noise: PathNoise,
    prior: PosePrior,
) -> Bend | None:
    """Refine the halves of the covered part from the pose of the whole; None if either has too few bins."""
    is_covered = base.raster.lookup(T_base_walk.apply(walk.positions))[3]
    halves = [
        Half(rows, best.T_base_target, best.center, best.covariance)
        for rows in np.array_split(np.flatnonzero(is_covered), 2)
        for best in weigh_walk(base, walk.part(rows), [T_base_walk], noise, prior)[:1]
    ]
    return bend_between(T_base_walk, walk.positions, is_covered, halves)


def bend_of_map(
    base: PreparedMap, target: PreparedMap, pose: RefinedPose, prior: PosePrior, sensors: SensorMode, seed: int
) -> Bend | None:
    """Refine the halves of a map's samples, if they follow a path, from the pose of the whole.

    Only the base's map is looked up: the target's own map blends what both halves passed.
    """
    if not has_path_order(target.samples):
        return None
    T, side = pose.T_base_target, 2 * common_length(base, target)
    is_covered = base.raster.lookup(T.apply(target.samples))[3]
    unlooked, drift, halves = base.part(NO_ROWS), target.drift.together(base.drift), list[Half]()
    for rows in np.array_split(np.flatnonzero(is_covered), 2):
        part = replace(target, drift=drift).part(rows)
        half = refine(unlooked, part, pose, prior, sensors, np.random.default_rng(seed))
        seen = joint_covariance(half, side) if half.blocks else None
        if seen is not None:
            of_map = map_covariance(unlooked, part, half, seed)
            covariance = enclosing(seen[:6, :6], of_map) + drift_covariance(half)
            halves.append(Half(rows, half.T_base_target, half.center, covariance))
    return bend_between(T, target.samples, is_covered, halves)
