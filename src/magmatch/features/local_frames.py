# SPDX-License-Identifier: BSD-3-Clause
"""Local reference frames: axes at each keypoint that turn with the field around it."""

from dataclasses import dataclass

import numpy as np

from magmatch.features.config import FeatureConfig
from magmatch.features.infer import Inferred
from magmatch.geometry import unit_vectors
from magmatch.typing import Indices, Scalars, Tensors, Vectors

# Support vectors held in memory at once.
CHUNK = 1_000_000


@dataclass(frozen=True, eq=False, slots=True)
class LocalFrames:
    """Keypoints with axes that turn with the field around them.

    Attributes
    ----------
    rows : (k,) array
        The keypoints, as rows of X*.
    axes : (k, 3, 3) array
        Columns are the axes x, y, z in the map frame: they take local coordinates to map coordinates.
    strength : (k,) array
        Length of the sum that gives the x-axis, over the sum of lengths: near 0 the axis is noise.
    support : (k, s) array
        Rows of X* within the radius of each keypoint, itself left out; -1 where X* has no point.
    """

    rows: Indices
    axes: Tensors
    strength: Scalars
    support: np.ndarray

    def __len__(self) -> int:
        return len(self.rows)

    def __repr__(self) -> str:
        return f"LocalFrames({len(self)} keypoints)"


def local_frames(inferred: Inferred, rows: Indices, config: FeatureConfig | None = None) -> LocalFrames:
    """Lay a frame at each keypoint: z along the field, x along the field around it.

    Parameters
    ----------
    inferred : Inferred
        The field at X*.
    rows : (k,) array of ints
        Keypoints.
    config : FeatureConfig, optional
        Radius of the support, its Gaussian weight, and the least strength of an x-axis.

    Returns
    -------
    LocalFrames
        Of the keypoints whose x-axis is stronger than noise.
    """
    config = config or FeatureConfig()
    support, distance = inferred.support(rows, config.support_radius)
    axes, strength = frame_axes(inferred.field, rows, support, distance, config.frame_sd)
    kept = strength > config.min_frame_strength
    return LocalFrames(rows[kept], axes[kept], strength[kept], support[kept])


def frame_axes(
    field: Vectors,
    keypoint_rows: np.ndarray,
    neighbours: np.ndarray,
    distance: Scalars,
    frame_sd: float,
) -> tuple[Tensors, Scalars]:
    """Frames whose z-axis is the field and whose x-axis is the field around: columns are axes in the map frame.

    The strength of each frame is the length of the weighted sum of projected vectors over the sum of their weighted
    lengths: near 0 the x-axis is noise, and it is 0 where there is no frame.

    ``z = B/|B|`` at the keypoint; ``x`` is the direction of ``sum_s w_s (I - z z^T) B_s``,
    ``w_s = exp(-d_s^2 / 2 frame_sd^2)``; ``y = z x x``.
    """
    own = field[keypoint_rows]
    z = unit_vectors(own)
    weight = np.exp(-0.5 * (distance / frame_sd) ** 2)
    total, lengths = np.zeros((len(own), 3)), np.zeros(len(own))
    step = max(CHUNK // max(neighbours.shape[1], 1), 1)
    for start in range(0, len(own), step):
        part = slice(start, start + step)
        vectors = np.where(neighbours[part, :, None] >= 0, field[neighbours[part]], 0.0)
        lateral = vectors - np.einsum("ksc,kc->ks", vectors, z[part])[..., None] * z[part, None, :]
        total[part] = np.einsum("s,ksc->kc", weight, lateral)
        lengths[part] = np.einsum("s,ks->k", weight, np.linalg.norm(lateral, axis=2))
    # Once more, so that the axes are orthogonal to rounding where the sum nearly cancels.
    total -= np.einsum("kc,kc->k", total, z)[:, None] * z
    x = unit_vectors(total)
    tiny = np.finfo(float).tiny
    strength: Scalars = np.linalg.norm(total, axis=1) / np.maximum(lengths, tiny)
    strength[np.linalg.norm(own, axis=1) < tiny] = 0.0
    return np.stack([x, np.cross(z, x), z], axis=2), strength
