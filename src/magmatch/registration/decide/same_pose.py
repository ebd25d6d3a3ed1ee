# SPDX-License-Identifier: BSD-3-Clause
"""When two poses are one answer: nearer to each other than refinement would part them."""

from scipy.spatial.transform import RigidTransform

from magmatch.geometry import transform_error
from magmatch.typing import Vector3

# rad
SAME_ROTATION = 0.14


def is_same_pose(one: RigidTransform, other: RigidTransform, center: Vector3, distance: float) -> bool:
    """Whether two poses of a target, about its centre, are one answer; the distance (m) is the caller's."""
    apart, angle = transform_error(one, other, center)
    return angle < SAME_ROTATION and apart < distance
