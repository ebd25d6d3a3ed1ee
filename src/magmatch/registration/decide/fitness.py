# SPDX-License-Identifier: BSD-3-Clause
"""The published check of a transform: whether the target's vectors, aligned, point where the base's field points."""

from dataclasses import dataclass

import numpy as np
from scipy.spatial.transform import RigidTransform

from magmatch.data.survey import Survey
from magmatch.field.map import FieldMap
from magmatch.geometry import rotate_vectors, transform_points
from magmatch.typing import Vectors


@dataclass(frozen=True, slots=True)
class Fitness:
    """How well a transform aligns vectors."""

    value: float  # see `mean_misalignment`; 1 where nothing overlaps
    overlap: float  # share of the target's samples that fall where the base map knows the field


def mean_misalignment(aligned: Vectors, expected: Vectors) -> float:
    """Mean norm of the cross product of vectors that should agree, over the mean product of their norms."""
    product = np.linalg.norm(aligned, axis=1) * np.linalg.norm(expected, axis=1)
    cross = np.linalg.norm(np.cross(aligned, expected), axis=1)
    is_opposed = np.einsum("ni,ni->n", aligned, expected) < 0
    total = float(product.sum())
    return float(np.where(is_opposed, product, cross).sum()) / total if total > 0 else 1.0


def alignment_fitness(base_map: FieldMap, target: Survey, T_base_target: RigidTransform) -> Fitness:
    """Carry the target's samples into the base map by a transform, and compare directions there."""
    p_base = transform_points(target.positions, T_base_target)
    is_known = base_map.knows(p_base)
    if not is_known.any():
        return Fitness(1.0, 0.0)
    expected = base_map.evaluate(p_base[is_known]).field
    aligned = rotate_vectors(target.field[is_known], T_base_target)
    return Fitness(mean_misalignment(aligned, expected), float(is_known.mean()))
