# SPDX-License-Identifier: BSD-3-Clause
"""Poses that a search tries, each stated by where it puts one point of the target; the best without repetition."""

from typing import NamedTuple, Self

import numpy as np
from scipy.spatial.transform import RigidTransform

from magmatch.compiled import compiled_ahead, record
from magmatch.geometry import transform_of
from magmatch.typing import Indices, Points, Scalars, Tensors, Vector3

# Inaccuracy of a pose that one pair of points proposes: rad, and in correlation lengths.
POSE_TURN, POSE_SHIFT = 0.1, 0.2
# Share of samples that may match nothing under a right pose (moved furniture, a passing lift).
OUTLIER_SHARE = 0.3


def pose_inaccuracy(length: float) -> tuple[float, float]:
    """Inaccuracy of a pose that one pair of points proposes (rad, m), for a correlation length (m)."""
    return POSE_TURN, POSE_SHIFT * length


def same_pose(length: float) -> tuple[float, float]:
    """Angle and distance (rad, m) within which two such poses are one: both inaccuracies together."""
    turn, shift = pose_inaccuracy(length)
    return 2 * turn, 2 * shift


class CandidatePoses(NamedTuple):
    """Poses that each rotate about an anchor: ``p_base = anchor_base + R (p_target - anchor_target)``."""

    rotations: Tensors  # (h, 3, 3)
    anchors_base: Points  # (h, 3), m: where each pose puts its anchor, base model frame
    anchor_rows: Indices  # (h,) ints: which anchor each pose belongs to
    anchors_target: Points  # (a, 3), m

    def subset(self, rows: Indices | slice) -> Self:
        """A subset of the poses."""
        return self._replace(
            rotations=self.rotations[rows], anchors_base=self.anchors_base[rows], anchor_rows=self.anchor_rows[rows]
        )

    def carry(self, p_target: Vector3) -> Points:
        """Carry a given point of the target by each pose: (h, 3), m."""
        arms = p_target - self.anchors_target[self.anchor_rows]
        return np.asarray(self.anchors_base + np.einsum("nij,nj->ni", self.rotations, arms))

    def pose(self, k: int, p_base: Vector3, p_target: Vector3) -> RigidTransform:
        """One pose as a transform, given where `carry` puts a point."""
        R = self.rotations[k]
        return transform_of(R, p_base - R @ p_target)


CANDIDATE_POSES = record(CandidatePoses, "f8[:,:,::1], f8[:,::1], i8[::1], f8[:,::1]")


def distinct_poses(
    rotations: Tensors, centers: Points, scores: Scalars, angle: float, distance: float, limit: int
) -> Indices:
    """Best poses that differ from every better one by an angle (rad) or by the position of the centre (m)."""
    order = np.argsort(-scores, kind="stable")
    kept = np.zeros(min(limit, len(order)), dtype=np.int64)
    n = _first_distinct(rotations[order], centers[order], 1 + 2 * np.cos(angle), distance**2, kept)
    return np.asarray(order[kept[:n]], dtype=np.int64)


@compiled_ahead("f8[:,:,::1], f8[:,::1], f8, f8, i8[::1]")
def _first_distinct(R, centers, least_trace, distance2, kept):  # type: ignore[no-untyped-def]
    """List rows that no kept row before them resembles (trace of the relative rotation, squared distance)."""
    n = 0
    for row in range(len(R)):
        is_new = n < len(kept)
        for k in range(n):
            d2, trace = 0.0, 0.0
            for c in range(3):
                step = centers[kept[k], c] - centers[row, c]
                d2 += step * step
            if d2 < distance2:
                for a in range(3):
                    for b in range(3):
                        trace += R[kept[k], a, b] * R[row, a, b]
                if trace > least_trace:
                    is_new = False
                    break
        if is_new:
            kept[n] = row
            n += 1
            if n == len(kept):
                break
    return n
