# SPDX-License-Identifier: BSD-3-Clause
"""Factors between nodes: odometry between neighbours, closures, submaps of several passes, fixed points."""

from collections.abc import Sequence
from dataclasses import dataclass, fields
from functools import cached_property

import numpy as np
from scipy.spatial.transform import RigidTransform

from magmatch.slam.config import LEAST_KEPT, MOST_ODDS
from magmatch.typing import Covariance6, Indices, Mask, Points, Scalars, Tensors

# Lasting errors of a log's odometry: scale and turn rate.
N_LASTING = 2


@dataclass(frozen=True, eq=False)
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
        """No odometry."""
        nodes = np.zeros(0, np.int64)
        return cls(nodes, nodes, np.zeros((0, 3)), np.zeros((0, 6, 6)), np.zeros((0, 6, N_LASTING)), nodes)

    @cached_property
    def information(self) -> Tensors:
        """Inverse of each covariance: (e, 6, 6)."""
        return np.linalg.inv(self.covariance)

    def with_more(self, more: "Edges") -> "Edges":
        """Join these edges and others."""
        names = (f.name for f in fields(self))
        return Edges(*(np.concatenate([getattr(self, name), getattr(more, name)]) for name in names))


@dataclass(frozen=True, eq=False, slots=True)
class FixedPoints:
    """Points of logs whose place is known."""

    one: Indices  # (a,): nodes before and after each
    other: Indices  # (a,)
    share: Scalars  # (a,): of the way between them that is behind
    x: Points  # (a, 3), m: odometry's frame
    position: Points  # (a, 3), m: where it is in the surveyor's frame, and how well that is known per axis
    sd: Scalars  # (a,), m

    def only(self, rows: Indices) -> "FixedPoints":
        """Select some fixed points."""
        return FixedPoints(*(getattr(self, f.name)[rows] for f in fields(self)))


@dataclass(frozen=True, eq=False, slots=True)
class Closure:
    """Two nodes near one place."""

    first: int  # nodes
    second: int
    T_first_second: RigidTransform  # from the field
    covariance: Covariance6  # (6, 6): of xi in ``T Exp(xi)`` about the second node, rotation first (rad, m)
    log_odds: float  # probability that it is right, from the field alone
    weight: float = 1.0  # probability that it is right, given the graph
    common: float = 0.0  # share of the covariance that is one window's own, so that its other closures have it too
    # Squared residual against what the graph predicted when it was found: its odds have paid for that.
    paid: float = 0.0

    @property
    def is_kept(self) -> bool:
        """Whether the graph keeps it, which is also required to connect two logs."""
        return self.weight > LEAST_KEPT


@dataclass(frozen=True, eq=False, slots=True)
class SubmapFactor:
    """A node on a map that several passes of its log made, all before it or all after: it moves with all of them.

    It stands for the node's closures with these passes, each of which was found on a map of one of two passes.
    """

    node: int
    passes: Indices  # (k,): a node of each
    shares: Scalars  # (k,): share of each in the map; they sum to one
    R: Tensors  # (k, 3, 3), and t (k, 3), m: the node in the axes of each of those, where the graph had them then
    t: Points
    covariance: Covariance6  # (6, 6): of xi in ``T Exp(xi)`` about the node, rotation first (rad, m)
    probability: float
    part: float = 1.0  # of the log's likelihood: a half, where it is told in both orders


@dataclass(frozen=True, eq=False, slots=True)
class ClosureArrays:
    """Closures as arrays."""

    first: Indices  # (c,): nodes
    second: Indices
    R: Tensors  # (c, 3, 3), and t (c, 3), m: of the second node in the first's axes
    t: Points
    information: Tensors  # (c, 6, 6): rotation in the second node's axes, translation in the first's
    odds: Scalars  # (c,): log odds from the field alone, as far as they count
    weight: Scalars  # (c,), the share of the covariance that is one window's own, and what the odds have paid for
    common: Scalars
    paid: Scalars

    @classmethod
    def of(cls, closures: Sequence[Closure]) -> "ClosureArrays":
        """Arrays of some closures."""
        Z = np.array([c.T_first_second.as_matrix() for c in closures]).reshape(-1, 4, 4)
        R, C = Z[:, :3, :3], np.array([c.covariance for c in closures]).reshape(-1, 6, 6)
        # A closure's covariance is stated in the second node's axes.
        turn = np.zeros((len(Z), 6, 6))
        turn[:, :3, :3], turn[:, 3:, 3:] = np.eye(3), R
        first, second = (np.array([getattr(c, name) for c in closures], np.int64) for name in ("first", "second"))
        information = np.linalg.inv(turn @ C @ np.swapaxes(turn, 1, 2))
        odds, weight, common, paid = (
            np.array([getattr(c, name) for c in closures]) for name in ("log_odds", "weight", "common", "paid")
        )
        return cls(first, second, R, Z[:, :3, 3], information, np.minimum(odds, MOST_ODDS), weight, common, paid)

    @property
    def is_kept(self) -> Mask:
        """Whether the graph keeps each: (c,)."""
        return np.asarray(self.weight > LEAST_KEPT)
