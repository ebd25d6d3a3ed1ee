# SPDX-License-Identifier: BSD-3-Clause
"""A map declared for a box: inside the box it is its model, outside it is the prior."""

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, replace
from typing import Any, Self

import numpy as np
from scipy.spatial.transform import RigidTransform

from magmatch.field.hyperparameters import Hyperparameters
from magmatch.field.linear_model import FieldPosterior, Index, Piece
from magmatch.field.values import FieldValues
from magmatch.geometry import transform_points
from magmatch.grid import spanned_points
from magmatch.typing import Mask, Points, Scalars

# So far from any sample that every prior is back to itself, m.
NOWHERE = 1e7
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
        return transform_points(spanned_points(axes), self.T_box_model.inv())


@dataclass(frozen=True, eq=False, slots=True)
class BoundedPosterior:
    """A posterior within a box; fills `magmatch.field.linear_model.FieldPosterior`."""

    inner: FieldPosterior
    box: Box

    @property
    def hyperparameters(self) -> Hyperparameters:
        """The hyperparameters of the inner model."""
        return self.inner.hyperparameters

    @property
    def weights(self) -> Scalars:
        """The weights of the inner model."""
        return self.inner.weights

    @property
    def weights_by_tile(self) -> Mapping[Index, Scalars]:
        """The weights of the inner model, by tile."""
        return self.inner.weights_by_tile

    def evaluate(self, points: Points, order: int = 0, weights: Any | None = None) -> FieldValues:
        """See `FieldPosterior.evaluate`."""
        return self.inner.evaluate(self._or_nowhere(points), order, weights)

    def covariance(self, points: Points, order: int = 0) -> np.ndarray:
        """See `FieldPosterior.covariance`."""
        return self.inner.covariance(self._or_nowhere(points), order)

    def influence(self, points: Points) -> np.ndarray:
        """See `FieldPosterior.influence`: samples outside the box inform what lies inside."""
        return self.inner.influence(points)

    def pieces(self, points: Points) -> Iterable[Piece]:
        """See `FieldPosterior.pieces`: samples outside the box inform what lies inside."""
        return self.inner.pieces(points)

    def draw_weights(self, n_draws: int, rng: np.random.Generator) -> Iterable[Any]:
        """See `FieldPosterior.draw_weights`."""
        return self.inner.draw_weights(n_draws, rng)

    def without_factors(self) -> FieldPosterior:
        """See `FieldPosterior.without_factors`."""
        return replace(self, inner=self.inner.without_factors())

    def knows(self, points: Points) -> Mask:
        """See `FieldPosterior.knows`."""
        return np.asarray(self.inner.knows(points) & self.box.contains(points))

    def _or_nowhere(self, points: Points) -> Points:
        moved: Points = np.full_like(points, NOWHERE)
        is_inside = self.box.contains(points)
        moved[is_inside] = points[is_inside]
        return moved
