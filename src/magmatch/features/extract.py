# SPDX-License-Identifier: BSD-3-Clause
"""`extract_features`: a field map in, keypoints with local frames and descriptors out."""

from dataclasses import dataclass

import numpy as np
from scipy.spatial.transform import RigidTransform, Rotation

from magmatch.arguments import expect_kind
from magmatch.brief import brief
from magmatch.features.config import FeatureConfig
from magmatch.features.descriptors import describe
from magmatch.features.infer import Inferred, infer
from magmatch.features.keypoints import curvature_response, detect
from magmatch.features.local_frames import LocalFrames, local_frames
from magmatch.field.map import FieldMap
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


def extract_features(
    field_map: FieldMap, config: FeatureConfig | None = None, half_range: float | None = None
) -> Features:
    """Find the distinctive points of a map and describe their surroundings.

    Parameters
    ----------
    field_map : FieldMap
        A fitted map.
    config : FeatureConfig, optional
        Published settings unless given.
    half_range : float, T, optional
        Half range of the component histograms; maps to be compared must share it (and the spacing).
        By default from this map's own samples.

    Returns
    -------
    Features
        In the map's frame; empty if nothing stands out.
    """
    expect_kind(field_map, "field_map", (FieldMap,), "build_map(survey) makes one")
    config = config or FeatureConfig()
    inferred = infer(field_map, config)
    frames = local_frames(inferred, detect(inferred, config), config)
    return features_of(inferred, frames, describe(inferred, frames, half_range or config.component_range))


def features_of(inferred: Inferred, frames: LocalFrames, descriptors: Matrix) -> Features:
    """Put described keypoints together."""
    if not len(frames):
        return Features.empty(descriptors.shape[1])
    rows = frames.rows
    response = curvature_response(inferred.values)[rows]
    axes = Rotation.from_matrix(frames.axes)
    return Features(inferred.positions[rows], inferred.field[rows], response, axes, descriptors)
