# SPDX-License-Identifier: BSD-3-Clause
"""`extract_features`: a field map in, keypoints with local frames and descriptors out."""

import logging
from collections.abc import Sequence

from scipy.spatial.transform import Rotation

from magmatch.arguments import expect_kind
from magmatch.features.config import FeatureConfig
from magmatch.features.descriptors import N_DIMENSIONS, component_range, histograms_of_oriented_vectors
from magmatch.features.features import Features
from magmatch.features.grids import evaluate_at, inference_grid
from magmatch.features.keypoints import curvature_response, find_keypoints
from magmatch.features.local_frames import local_frames
from magmatch.field.map import FieldMap

log = logging.getLogger(__name__)


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
    points = inference_grid(field_map, config)
    values = evaluate_at(field_map, points)
    response = curvature_response(values)
    rows = find_keypoints(field_map, points, response, config)
    if not len(rows):
        return Features.empty(N_DIMENSIONS)

    neighbours, distance = points.support(rows, config.support_radius)
    frames, strength = local_frames(values.field, rows, neighbours, distance, config.frame_sd)
    kept = strength > config.min_frame_strength
    rows, neighbours, frames = rows[kept], neighbours[kept], frames[kept]
    log.info("%d of %d keypoints have a local frame", len(rows), len(kept))
    if not len(rows):
        return Features.empty(N_DIMENSIONS)

    half_range = shared_range([field_map], config) if half_range is None else half_range
    descriptors = histograms_of_oriented_vectors(values.field, neighbours, frames, half_range)
    return Features(
        points.positions[rows], values.field[rows], response[rows], Rotation.from_matrix(frames), descriptors
    )


def shared_range(field_maps: Sequence[FieldMap], config: FeatureConfig) -> float:
    """Half range of the component histograms that suits all maps: configured, or scaled to their samples, T."""
    return config.component_range or max(component_range(m.survey.field) for m in field_maps)
