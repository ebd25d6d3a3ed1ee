# SPDX-License-Identifier: BSD-3-Clause
"""The box that a map is declared for."""

from dataclasses import dataclass
from typing import Self

import numpy as np
from scipy.spatial.transform import RigidTransform

from magmatch.geometry import transform_points
from magmatch.typing import Mask, Points

# Most points that stand for a box.
_N_LATTICE = 50_000


@dataclass(frozen=True, eq=False, slots=True)
class Box:
    """A box, turned against the model's axes."""

    low: np.ndarray  # (3,), m: corners, in the box's own axes
    high: np.ndarray  # (3,), m
    T_box_model: RigidTransform  # takes model coordinates to the box's

    @classmethod
    def declared(cls, domain: tuple[float, ...] | None, T_domain_model: RigidTransform | None) -> Self | None:
        """Box of a configuration's ``domain``, whose axes are the model's unless stated."""
        if domain is None:
            return None
        T = RigidTransform.identity() if T_domain_model is None else T_domain_model
        return cls(np.array(domain[:3]), np.array(domain[3:]), T)

    def contains(self, points: Points) -> Mask:
        """Whether points (model frame) lie in the box."""
        p = transform_points(points, self.T_box_model)
        return np.asarray(np.all((p >= self.low) & (p <= self.high), axis=1), dtype=np.bool_)

    def lattice_step(self, wished: float) -> float:
        """Distance of the lattice's points that can be afforded, m."""
        size = self.high - self.low
        return float(max(wished, np.cbrt(size).prod() / np.cbrt(_N_LATTICE), size.max() / 1000))

    def lattice(self, step: float) -> Points:
        """Points no farther apart than a step that fill the box, in the model's frame."""
        n_steps = np.ceil((self.high - self.low) / step).astype(np.int64)
        axes = [np.linspace(a, b, n + 1) for a, b, n in zip(self.low, self.high, n_steps, strict=True)]
        points = np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1).reshape(-1, 3)
        return transform_points(points, self.T_box_model.inv())
