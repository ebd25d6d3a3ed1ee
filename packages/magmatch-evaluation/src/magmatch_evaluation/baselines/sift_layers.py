# SPDX-License-Identifier: BSD-3-Clause
"""SIFT on heat maps: layers of |B| as images, matched keypoints as points of space, the transform by MSAC.

The published baseline, of which the paper says no more than that. It sees what `paper` sees: the field where X* lies,
within the measurements. What the paper leaves open is settled in its favour: grey levels are shared by both surveys,
keypoints are matched across all layers, the ratio test looks for the second best match elsewhere (neighbouring layers
show the same blob), and keypoints count as points of space at the height of their layer, so that any rigid transform
can come out.
"""

from typing import Literal

import cv2
import numpy as np
from pydantic import BaseModel, ConfigDict, Field
from scipy.spatial import cKDTree

from magmatch.field.map import FieldMap
from magmatch.published.consensus import ConsensusConfig, vector_msac
from magmatch.registration.result import RegistrationResult
from magmatch.typing import Indices, Points, Vectors
from magmatch_evaluation.baselines.judged import judged
from magmatch_evaluation.baselines.volume import (
    Layer,
    Volume,
    cut_layers,
    magnitude_volume,
    shared_spacing,
    within_measurements,
)

# Neighbours in descriptor space among which the best match elsewhere is looked for.
N_NEIGHBOURS = 30
# Smaller images hold no keypoint worth having.
MIN_SIDE = 16


class SiftConfig(BaseModel):
    """How layers are cut, and how their keypoints are matched; chosen on office-z30, seeds 0, 1 and 3."""

    model_config = ConfigDict(frozen=True, extra="forbid")

    # Whether layers are cut across z only (published) or across many directions.
    directions: Literal["vertical", "many"] = "vertical"
    # Pixels in one lengthscale of the shorter-ranged map, and most points of a grid.
    pixels_per_lengthscale: float = Field(default=20.0, gt=0)
    max_points: int = Field(default=1_500_000, ge=1000)
    # Distance of layers, pixels, and most layers in one direction.
    layer_gap: float = Field(default=1.5, gt=0)
    max_layers: int = Field(default=24, ge=1)
    # SIFT's own threshold of contrast (OpenCV's default 0.04 keeps few blobs of a field as smooth as this).
    contrast: float = Field(default=0.0, ge=0)
    # SIFT's threshold of edges (OpenCV's default 10 drops what is long, as most of a field's ridges are).
    edge: float = Field(default=50.0, gt=0)
    octave_layers: int = Field(default=8, ge=1)
    # Largest ratio of the best distance to that of the best match elsewhere.
    max_ratio: float = Field(default=0.9, gt=0, le=1)
    # Distance at which a match stops counting, pixels.
    inlier_distance: float = Field(default=6.0, gt=0)
    min_inliers: int = Field(default=6, ge=3)
    n_hypotheses: int = Field(default=5000, ge=1)


def register_by_sift(base_map: FieldMap, target_map: FieldMap, config: SiftConfig, seed: int) -> RegistrationResult:
    """Register two maps by SIFT keypoints of their layers."""
    spacing = shared_spacing(base_map, target_map, config.pixels_per_lengthscale, config.max_points)
    volumes = [within_measurements(magnitude_volume(m, spacing), m) for m in (base_map, target_map)]
    grey = _grey_range(volumes)
    of_base, of_target = _normals(config)
    base_points, base_descriptors = _keypoints(volumes[0], of_base, grey, config)
    target_points, target_descriptors = _keypoints(volumes[1], of_target, grey, config)
    distance = config.inlier_distance * spacing
    rows = match_elsewhere(base_points, base_descriptors, target_descriptors, 2 * distance, config.max_ratio)
    p_base, p_target = base_points[rows[0]], target_points[rows[1]]
    consensus = ConsensusConfig(vector_weight=0.0, min_inliers=config.min_inliers, n_hypotheses=config.n_hypotheses)
    none = np.ones_like(p_base)
    found = vector_msac(p_base, p_target, none, none, distance, consensus, np.random.default_rng(seed))
    if not found:
        return judged(base_map, target_map, None, n_correspondences=len(p_base))
    n_inliers = int(found[0].is_inlier.sum())
    return judged(base_map, target_map, found[0].T_base_target, n_correspondences=len(p_base), n_inliers=n_inliers)


def match_elsewhere(
    base_points: Points, base: np.ndarray, target: np.ndarray, apart: float, max_ratio: float
) -> tuple[Indices, Indices]:
    """Rows of base and target descriptors matched by a ratio test whose second best lies elsewhere, `apart` in m."""
    none = np.zeros(0, dtype=np.int64)
    if not len(base) or not len(target):
        return none, none
    k = min(N_NEIGHBOURS, len(base))
    distance, rows = (np.reshape(a, (len(target), k)) for a in cKDTree(base).query(target, k))
    away = np.linalg.norm(base_points[rows] - base_points[rows[:, :1]], axis=2) > apart
    # Where all neighbours are of one place, the rival is at least as far as the last of them.
    second = np.where(away.any(axis=1), distance[np.arange(len(rows)), away.argmax(axis=1)], distance[:, -1])
    kept = np.flatnonzero(distance[:, 0] <= max_ratio * second)
    return rows[kept, 0].astype(np.int64), kept.astype(np.int64)


def _keypoints(
    volume: Volume, normals: Vectors, grey: tuple[float, float], config: SiftConfig
) -> tuple[Points, np.ndarray]:
    """Keypoints of all layers as points of space, with their descriptors."""
    sift = cv2.SIFT.create(
        nOctaveLayers=config.octave_layers, contrastThreshold=config.contrast, edgeThreshold=config.edge
    )
    points, descriptors = [np.zeros((0, 3))], [np.zeros((0, 128), dtype=np.float32)]
    gap = config.layer_gap * volume.grid.spacing
    for normal in normals:
        for layer in cut_layers(volume, normal, gap, config.max_layers):
            if min(layer.magnitude.shape) < MIN_SIDE or not layer.is_known.any():
                continue
            mask = layer.is_known.astype(np.uint8) * 255
            found, described = sift.detectAndCompute(_image(layer, grey), mask)
            if found:
                points.append(layer.points(np.array([keypoint.pt for keypoint in found], dtype=np.float64)))
                descriptors.append(np.asarray(described, dtype=np.float32))
    return np.concatenate(points), np.concatenate(descriptors)


def _image(layer: Layer, grey: tuple[float, float]) -> np.ndarray:
    """Eight bits of grey."""
    low, high = grey
    scaled = 255 * (layer.magnitude - low) / max(high - low, np.finfo(float).tiny)
    return np.clip(np.rint(scaled), 0, 255).astype(np.uint8)


def _grey_range(volumes: list[Volume]) -> tuple[float, float]:
    """Black and white, shared by both surveys: nearly all that is known lies between."""
    known = np.concatenate([v.magnitude[v.is_known] for v in volumes])
    if not len(known):
        return 0.0, 1.0
    low, high = np.quantile(known, [0.005, 0.995])
    return float(low), float(high)


def _normals(config: SiftConfig) -> tuple[Vectors, Vectors]:
    """Directions that either survey is cut across.

    With 'many', the base is cut across the 31 axes of an icosahedron (corners, faces, edges: one within 21 degrees of
    any direction), the target across its own axes, seen from both sides, since an image is not its mirror image.
    """
    z = np.array([[0.0, 0.0, 1.0]])
    if config.directions == "vertical":
        return z, z
    return icosahedron_axes(), np.concatenate([np.eye(3), -np.eye(3)])


def icosahedron_axes() -> Vectors:
    """Unit vectors through the corners, face centres and edge centres of an icosahedron, one of each opposite two."""
    golden = (1 + np.sqrt(5)) / 2
    corners = np.array([
        np.roll([0, one, golden * other], shift) for shift in range(3) for one in (-1, 1) for other in (-1, 1)
    ])  # fmt: skip
    near = np.isclose(np.linalg.norm(corners[:, None] - corners[None], axis=2), 2)
    edges = [corners[i] + corners[j] for i, j in np.argwhere(np.triu(near))]
    faces = [
        corners[i] + corners[j] + corners[k]
        for i, j in np.argwhere(np.triu(near)) for k in range(j + 1, len(corners)) if near[i, k] and near[j, k]
    ]  # fmt: skip
    every = np.concatenate([corners, faces, edges])
    unit = every / np.linalg.norm(every, axis=1)[:, None]
    tilted = unit @ np.array([1.0, 1e-3, 1e-6])  # no axis is at right angles to this
    half: Vectors = unit[tilted > 0]
    return half
