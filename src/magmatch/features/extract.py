# SPDX-License-Identifier: BSD-3-Clause
"""`extract_features`: a field map in, keypoints with local frames and descriptors out."""

from scipy.spatial.transform import Rotation

from magmatch.arguments import expect_kind
from magmatch.features.config import FeatureConfig
from magmatch.features.descriptors import describe
from magmatch.features.features import Features
from magmatch.features.infer import Inferred, infer
from magmatch.features.keypoints import curvature_response, detect
from magmatch.features.local_frames import LocalFrames, local_frames
from magmatch.field.map import FieldMap
from magmatch.typing import Matrix


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
