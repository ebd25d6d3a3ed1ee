# SPDX-License-Identifier: BSD-3-Clause
"""`Features`: keypoints of one map with local frames and descriptors."""

from dataclasses import dataclass

import numpy as np
from scipy.spatial.transform import RigidTransform, Rotation

from magmatch.brief import brief
from magmatch.geometry import rotate_vectors, transform_points
from magmatch.typing import Matrix, Points, Scalars, Vectors


@dataclass(frozen=True, eq=False, slots=True)
class Features:
    """Keypoints of one map.

    Attributes
    ----------
    positions : (k, 3) array, m, map frame
    field : (k, 3) array, T, map frame
    response : (k,) array
        Detector response (determinant of the Hessian of |B|), strongest is most distinctive.
    local_frames : Rotation of length k, or None where k = 0
        Takes local-frame coordinates to map coordinates (columns are the axes x, y, z).
    descriptors : (k, d) array
        Rotation-invariant description of the surroundings.
    """

    positions: Points
    field: Vectors
    response: Scalars
    local_frames: Rotation | None
    descriptors: Matrix

    __repr__ = brief

    def __len__(self) -> int:
        return len(self.positions)

    @classmethod
    def empty(cls, n_dimensions: int) -> "Features":
        """No keypoint at all: a result, not an error."""
        none = np.zeros((0, 3))
        return cls(none, none, np.zeros(0), None, np.zeros((0, n_dimensions)))

    def transformed(self, T_new_map: RigidTransform) -> "Features":
        """Return the same features carried along with their map."""
        return Features(
            transform_points(self.positions, T_new_map),
            rotate_vectors(self.field, T_new_map),
            self.response,
            None if self.local_frames is None else T_new_map.rotation * self.local_frames,
            self.descriptors,
        )
