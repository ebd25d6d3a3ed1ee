# SPDX-License-Identifier: BSD-3-Clause
"""`fitness`: whether the target's vectors, aligned by a transform, point where the base's field points."""

from dataclasses import dataclass

import numpy as np
from pydantic import Field
from scipy.spatial.transform import RigidTransform

from magmatch.data.survey import Survey
from magmatch.field.map import FieldMap
from magmatch.geometry import rotate_vectors, transform_points
from magmatch.settings import Settings
from magmatch.typing import Vectors


class FitnessConfig(Settings):
    """When a consensus is accepted."""

    # Least share of the samples inside the base map.
    min_overlap: float = Field(default=0.05, ge=0, le=1)
    # Largest mean sine-weighted misalignment of aligned vectors.
    max_fitness: float = Field(default=0.1, gt=0)
    # Or the largest mean norm of the cross product of aligned vectors, T^2, as published (no number is printed).
    max_cross: float | None = Field(default=None, gt=0)


@dataclass(frozen=True, slots=True)
class Fitness:
    """How well a transform aligns vectors.

    Attributes
    ----------
    value : float
        Mean norm of the cross product of aligned vectors, over the mean product of their norms: 0 where all agree, 1
        where they are at right angles, opposed, or nothing overlaps.
    overlap : float
        Share of the target's samples that fall where the base map knows the field.
    cross : float, T^2
        The same mean norm before it is divided, as printed; infinite where nothing overlaps. Opposed vectors
        count 0 here.
    """

    value: float
    overlap: float
    cross: float = np.inf

    def passes(self, config: FitnessConfig) -> bool:
        """Whether it is below the threshold, with enough overlap."""
        is_low = self.value <= config.max_fitness if config.max_cross is None else self.cross <= config.max_cross
        return self.overlap >= config.min_overlap and is_low

    def __str__(self) -> str:
        return f"fitness {self.value:.3g} over {self.overlap:.0%} of the target"


def fitness(base_map: FieldMap, target: Survey, T_base_target: RigidTransform) -> Fitness:
    """Carry the target's samples into the base map by a transform, and compare directions there.

    Parameters
    ----------
    base_map : FieldMap
    target : Survey
    T_base_target : RigidTransform
        To be checked.

    Returns
    -------
    Fitness
        Over the samples that fall where the base map knows the field.
    """
    p_base = transform_points(target.positions, T_base_target)
    is_known = base_map.knows(p_base)
    if not is_known.any():
        return Fitness(1.0, 0.0)
    expected = base_map.evaluate(p_base[is_known]).field
    aligned = rotate_vectors(target.field[is_known], T_base_target)
    cross = float(np.linalg.norm(np.cross(aligned, expected), axis=1).mean())
    return Fitness(mean_misalignment(aligned, expected), float(is_known.mean()), cross)


def mean_misalignment(aligned: Vectors, expected: Vectors) -> float:
    """Mean norm of the cross product of vectors that should agree, over the mean product of their norms."""
    product = np.linalg.norm(aligned, axis=1) * np.linalg.norm(expected, axis=1)
    cross = np.linalg.norm(np.cross(aligned, expected), axis=1)
    is_opposed = np.einsum("ni,ni->n", aligned, expected) < 0
    total = float(product.sum())
    return float(np.where(is_opposed, product, cross).sum()) / total if total > 0 else 1.0
