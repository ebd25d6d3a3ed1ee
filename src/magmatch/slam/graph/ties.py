# SPDX-License-Identifier: BSD-3-Clause
"""Factors between nodes: odometry between neighbours, closures, fixed points."""

from dataclasses import dataclass, fields

import numpy as np
from scipy.spatial.transform import RigidTransform

from magmatch.typing import Covariance6, Indices, Points, Scalars, Tensors

# Lasting errors of a log's odometry: scale and turn rate.
N_LASTING = 2


@dataclass(frozen=True, eq=False, slots=True)
class Edges:
    """Odometry between neighbouring nodes: shift (e, 3), covariance (e, 6, 6), lasting errors (e, 6, 2), log (e,)."""

    first: Indices
    second: Indices
    shift: Points
    covariance: Tensors
    lasting: np.ndarray
    log: Indices

    @classmethod
    def none(cls) -> "Edges":
        """Without any."""
        nodes = np.zeros(0, np.int64)
        return cls(nodes, nodes, np.zeros((0, 3)), np.zeros((0, 6, 6)), np.zeros((0, 6, N_LASTING)), nodes)

    def with_more(self, more: "Edges") -> "Edges":
        """These, then others."""
        names = (f.name for f in fields(self))
        return Edges(*(np.concatenate([getattr(self, name), getattr(more, name)]) for name in names))


@dataclass(frozen=True, eq=False, slots=True)
class FixedPoints:
    """Points of logs whose place is known.

    Attributes
    ----------
    one, other : (a,) int arrays
        Nodes before and after each.
    share : (a,) array
        Of the way between them that is behind.
    x : (a, 3) array, m
        Odometry's frame.
    position, sd : (a, 3) and (a,) arrays, m
        Where it is in the surveyor's frame, and how well that is known per axis.
    """

    one: Indices
    other: Indices
    share: Scalars
    x: Points
    position: Points
    sd: Scalars


@dataclass(frozen=True, eq=False, slots=True)
class Closure:
    """Two nodes near one place.

    Attributes
    ----------
    first, second : int
        Nodes.
    T_first_second : RigidTransform
        From the field.
    covariance : (6, 6) array
        Of xi in ``T Exp(xi)`` about the second node, rotation first (rad, m).
    log_odds : float
        That it is right, from the field alone.
    weight : float
        Probability that it is right, given the graph.
    """

    first: int
    second: int
    T_first_second: RigidTransform
    covariance: Covariance6
    log_odds: float
    weight: float = 1.0

    @property
    def is_kept(self) -> bool:
        """Whether the graph keeps it, which is also required to connect two logs."""
        return self.weight > 0.5
