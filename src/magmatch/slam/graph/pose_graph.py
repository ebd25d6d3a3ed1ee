# SPDX-License-Identifier: BSD-3-Clause
"""The pose graph: nodes, their factors (odometry, closures, submaps, fixed points), and their covariances.

Odometry predicts the next node, up to a random walk and two constant errors per log, scale and turn rate.
"""

from collections.abc import Sequence
from copy import copy
from dataclasses import dataclass, field, replace

import numpy as np
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components
from scipy.spatial.transform import RigidTransform

from magmatch.geometry import ROUNDING, skew, transform_of
from magmatch.slam.config import SlamConfig
from magmatch.slam.graph.block_cholesky import BlockCholesky
from magmatch.slam.graph.factors import N_LASTING, Closure, ClosureArrays, Edges, FixedPoints, SubmapFactor
from magmatch.typing import Covariance6, Indices, Mask, Matrix, Points, Scalars, Tensors

# Standard deviation of what is held fixed: the first node of a component, and directions in which odometry does not
# drift.
SURE = 1e-4
# The same of what fixed points need not tell, such as where the frame of a single one points to: rad, m.
FREE = 1e3
# Standard deviations beyond which a difference is one.
DISTINCT = 3.0
# Nodes nearer than this along one log are one pass of a place, and are not compared: their windows adjoin.
APART = 2


@dataclass(eq=False)
class PoseGraph:
    """Poses of all nodes, and the factors between them."""

    config: SlamConfig
    # (n, 3, 3): nodes in the frame of their component
    R: Tensors = field(default_factory=lambda: np.zeros((0, 3, 3)))
    p: Points = field(default_factory=lambda: np.zeros((0, 3)))  # (n, 3)
    log: Indices = field(default_factory=lambda: np.zeros(0, np.int64))  # (n,): of each node
    edges: Edges = field(default_factory=Edges.none)
    # (logs, 2): estimated log of the scale of each log's odometry, and its turn rate (rad/m)
    lasting: Matrix = field(default_factory=lambda: np.zeros((0, 2)))
    fixed: FixedPoints | None = None  # a component that they determine has their frame instead of its own
    submap_factors: tuple[SubmapFactor, ...] = ()  # instead of the closures with the passes of their submaps
    _closures: tuple[Closure, ...] = ()
    _arrays: ClosureArrays | None = None
    # Of the information of all poses, from which their covariances follow
    factor: BlockCholesky | None = None

    def __post_init__(self) -> None:
        self.start, self.level = self.p.copy(), self.p[:, 2].copy()
        if not len(self.lasting):
            self.lasting = np.zeros((int(self.log.max(initial=-1)) + 1, N_LASTING))

    def copied(self) -> "PoseGraph":
        """Copy the graph, to try something on: what is moved or closed there stays as it is here."""
        other = copy(self)
        other.R, other.p, other.level = self.R.copy(), self.p.copy(), self.level.copy()
        return other

    @property
    def closures(self) -> tuple[Closure, ...]:
        """Closures between nodes; they are set all at once."""
        return self._closures

    @closures.setter
    def closures(self, closures: Sequence[Closure]) -> None:
        self._closures, self._arrays = tuple(closures), None

    @property
    def as_arrays(self) -> ClosureArrays:
        """The closures as arrays."""
        if self._arrays is None:
            self._arrays = ClosureArrays.of(self._closures)
        return self._arrays

    def weigh_closures(self, weight: Scalars) -> None:
        """Give each closure another weight."""
        arrays, pairs = self.as_arrays, zip(self._closures, weight.tolist(), strict=True)
        self.closures = [c if c.weight == w else replace(c, weight=w) for c, w in pairs]
        self._arrays = replace(arrays, weight=weight)

    def grow(self, centers: Points, logs: Indices, edges: Edges) -> None:
        """Add nodes at the end: where odometry leads from those before, or in a frame of their own."""
        self.edges = self.edges.with_more(edges)
        self.log = np.concatenate([self.log, logs])
        self.start = np.concatenate([self.start, centers])
        self.p = np.concatenate([self.p, centers])
        self.R = np.concatenate([self.R, np.tile(np.eye(3), (len(centers), 1, 1))])
        self.lasting = np.concatenate([self.lasting, np.zeros((int(self.log.max()) + 1 - len(self.lasting), 2))])
        self.level = np.concatenate([self.level, centers[:, 2]])
        for i, j, shift in zip(edges.first, edges.second, edges.shift, strict=True):
            self.R[j], self.p[j] = self.R[i], self.p[i] + self.R[i] @ shift
            self.level[j] = self.level[i] + shift[2]

    def frames(self) -> Indices:
        """For each log, the first log that shares its frame: by closures, or by fixed points that tell the frame."""
        root = self.connected()
        told = [r for r, rows in self.fixed_by(root).items() if self.tell_the_frame(rows)]
        root[np.isin(root, told)] = min(told, default=0)
        return root

    def component(self) -> Indices:
        """For each node, the first log that shares its frame, as `frames` has it."""
        return np.asarray(self.frames()[self.log])

    def is_one_pass(self, nodes: Indices | int, others: Indices | int) -> Mask:
        """Whether nodes adjoin others along one log."""
        return np.asarray((self.log[nodes] == self.log[others]) & (np.abs(nodes - others) < APART))

    def has_closure(self, nodes: Indices, second: int) -> Mask:
        """Whether a node has a closure with each of some others, or with one beside it on the same pass."""
        firsts = self.as_arrays.first[self.as_arrays.second == second]
        return np.asarray(self.is_one_pass(nodes[:, None], firsts).any(axis=1))

    def connected(self) -> Indices:
        """For each log, the first log that closures connect it to."""
        n, kept = len(self.lasting), np.flatnonzero(self.as_arrays.is_kept)
        one, other = self.log[self.as_arrays.first[kept]], self.log[self.as_arrays.second[kept]]
        group = connected_components(coo_array((np.ones(len(one)), (one, other)), shape=(n, n)), directed=False)[1]
        return np.asarray(np.unique(group, return_index=True)[1][group])

    def on_submaps(self) -> Scalars:
        """Part of each closure that submap factors of either node with the other's pass stand for: (c,)."""
        arrays, n, pairs, parts = self.as_arrays, len(self.p), [np.zeros(0, np.int64)], [np.zeros(0)]
        for f in self.submap_factors:
            others = np.unique(np.add.outer(f.passes, np.arange(1 - APART, APART)))
            pairs.append(n * np.maximum(f.node, others) + np.minimum(f.node, others))
            parts.append(np.full(len(others), f.part))
        known = np.concatenate(pairs)
        order, asked = np.argsort(known), n * arrays.second + arrays.first
        before = np.append(0.0, np.cumsum(np.concatenate(parts)[order]))
        first, end = (before[np.searchsorted(known[order], asked, side)] for side in ("left", "right"))
        return np.asarray((end - first) * (self.log[arrays.first] == self.log[arrays.second]))

    def fixed_by(self, root: Indices) -> dict[int, Indices]:
        """Fixed points of each group of logs that has any."""
        if self.fixed is None:
            return {}
        of = root[self.log[self.fixed.one]]
        return {int(r): np.flatnonzero(of == r) for r in np.unique(of)}

    def tell_the_frame(self, rows: Indices) -> bool:
        """Whether fixed points lie far enough apart, relative to their sd, to determine all rotations."""
        assert self.fixed is not None
        apart = (self.fixed.position[rows] - self.fixed.position[rows].mean(axis=0)) / self.fixed.sd[rows, None]
        upright = self.config.is_gravity_aligned
        lengths = np.linalg.svd(apart[:, :2] if upright else apart, compute_uv=False)
        # About the vertical one direction tells the turn, in space it takes two.
        return bool(lengths[0 if upright else 1 :].max(initial=0.0) > DISTINCT)

    def is_fixed(self, node: int) -> bool:
        """Whether fixed points tell the frame that a node is in."""
        frames = self.frames()
        rows = self.fixed_by(frames).get(int(frames[self.log[node]]))
        return rows is not None and self.tell_the_frame(rows)

    def seen_at_fixed(self) -> tuple[np.ndarray, np.ndarray]:
        """Places of the fixed points in the graph (a, 3), and the slopes with both nodes of each (a, 3, 12)."""
        f = self.fixed
        assert f is not None
        seen, slopes = np.zeros((len(f.sd), 3)), []
        for nodes, share in ((f.one, 1 - f.share), (f.other, f.share)):
            arm = f.x - self.start[nodes]
            seen += share[:, None] * (self.p[nodes] + np.einsum("nij,nj->ni", self.R[nodes], arm))
            slopes += [-share[:, None, None] * self.R[nodes] @ skew(arm), share[:, None, None] * self.R[nodes]]
        return seen, np.concatenate(slopes, axis=2)

    def off_fixed(self) -> Points:
        """Residual of each fixed point: (a, 3), m."""
        return np.zeros((0, 3)) if self.fixed is None else self.seen_at_fixed()[0] - self.fixed.position

    def off_fixed_without(self) -> tuple[Points, np.ndarray]:
        """Residual that each fixed point has without it, (a, 3), m, and covariance of that, (a, 3, 3).

        A stiff point draws the log to itself, so its own residual does not show that it is wrong. Of its covariance V
        and that of where the graph has it, S, the others' part is ``S^-1 - V^-1``.
        """
        if self.fixed is None:
            return np.zeros((0, 3)), np.zeros((0, 3, 3))
        f, (seen, J), own = self.fixed, self.seen_at_fixed(), self.marginals()
        between = self._factor.inverse_between(f.one, f.other)
        C = np.block([[own[f.one], between], [np.swapaxes(between, 1, 2), own[f.other]]])
        S = J @ C @ np.swapaxes(J, 1, 2) / f.sd[:, None, None] ** 2
        told, axes = np.linalg.eigh((S + np.swapaxes(S, 1, 2)) / 2)
        # Where nothing else tells a point's place, rounding decides what is left of one; its residual says nothing.
        # float64 tells no smaller share of a fixed point's information that others have from none.
        left, apart = np.maximum(1 - told, ROUNDING), np.einsum("aji,aj->ai", axes, seen - f.position)
        off = np.einsum("aij,aj->ai", axes, np.where(1 - told > ROUNDING, apart / left, 0.0))
        return off, axes / left[:, None, :] @ np.swapaxes(axes, 1, 2) * f.sd[:, None, None] ** 2

    def surprise_of_fixed(self) -> Scalars:
        """Squared residual that each fixed point has without it, in standard deviations: (a,)."""
        off, C = self.off_fixed_without()
        return np.asarray((off * np.linalg.solve(C, off[:, :, None])[:, :, 0]).sum(axis=1))

    def pose(self, k: int) -> RigidTransform:
        """Pose of a node in its component's frame."""
        return transform_of(self.R[k], self.p[k])

    def center(self, k: int) -> RigidTransform:
        """Pose of a node in its log's own frame, as odometry has it."""
        return RigidTransform.from_translation(self.start[k])

    def odometry(self, k: int) -> tuple[RigidTransform, Covariance6]:
        """Odometry's step from a node to the next of its log, and its covariance."""
        e = int(np.searchsorted(self.edges.first, k))
        o, L = self.config.odometry, self.edges.lasting[e]
        lasting = L @ np.diag([o.scale_sd**2, o.turn_rate_sd**2]) @ L.T
        return RigidTransform.from_translation(self.edges.shift[e]), self.edges.covariance[e] + lasting

    def relative_covariances(self, firsts: Indices, second: int) -> np.ndarray:
        """Covariance of xi in ``T_first_second Exp(xi)`` for each first node: (f, 6, 6), odometry's unit."""
        seconds = np.full(len(firsts), second)
        return self._relative(firsts, seconds, self._factor.inverse_in_column(second)[firsts])

    def relative_covariances_of_closures(self) -> np.ndarray:
        """Give the relative covariance of each closure's two nodes: (c, 6, 6)."""
        firsts, seconds = self.as_arrays.first, self.as_arrays.second
        return self._relative(firsts, seconds, self._factor.inverse_between(firsts, seconds))

    def _relative(self, firsts: Indices, seconds: Indices, between: np.ndarray) -> np.ndarray:
        own = self.marginals()
        # How a perturbation of each first node moves the second, in the second's axes: the adjoint of where it is.
        back = np.swapaxes(self.R[seconds], 1, 2)
        R = back @ self.R[firsts]
        A = np.zeros((len(firsts), 6, 6))
        A[:, :3, :3] = A[:, 3:, 3:] = R
        A[:, 3:, :3] = skew((back @ (self.p[firsts] - self.p[seconds])[:, :, None])[:, :, 0]) @ R
        AC = A @ between
        found = own[seconds] + A @ own[firsts] @ np.swapaxes(A, 1, 2) - AC - np.swapaxes(AC, 1, 2)
        return np.asarray((found + np.swapaxes(found, 1, 2)) / 2)

    def sds_of_place(self, firsts: Indices, second: int) -> Scalars:
        """Standard deviation of a node's place relative to each of some others, in the direction least known."""
        C = self.relative_covariances(firsts, second)[:, 3:, 3:]
        return np.asarray(np.sqrt(np.linalg.eigvalsh(C)[:, -1]))

    def covariances(self, nodes: Indices) -> np.ndarray:
        """Covariance of nodes (k,), in metres, with how well their scale is known: (k, 6, 6).

        Of ``T Exp(xi)``, T against the first node of their component, or in the frame of the fixed points.
        """
        if len(nodes) and self.is_fixed(int(nodes[0])):
            return np.asarray(self.marginals()[nodes])
        component, scaled, found = self.component(), self.scaled_logs(), np.zeros((len(nodes), 6, 6))
        for C, node in zip(found, nodes.tolist(), strict=True):
            first = int(np.argmax(component == component[node]))
            C[:] = self.relative_covariances(np.array([first]), node)[0]
            logs = scaled.get(int(component[node]))
            if logs is not None and len(self.edges.first):
                # Each log's scale is as likely as stated by itself, so their mean is known by so much better.
                along = (self.p[node] - self.p[first]) @ self.R[node] * self.config.odometry.scale_sd
                C[3:, 3:] += np.outer(along, along) / len(logs)
        return found

    def scaled_logs(self) -> dict[int, Indices]:
        """Logs of each component whose scale nothing tells: revisits show only that of one log relative to another's.

        Fixed points would tell it.
        """
        frames = self.frames()
        fixed = self.fixed_by(frames)
        return {int(name): np.flatnonzero(frames == name) for name in np.unique(frames) if name not in fixed}

    def marginals(self) -> np.ndarray:
        """Covariance of each node: (n, 6, 6)."""
        return self._factor.diagonal_of_inverse[: len(self.p)]

    @property
    def _factor(self) -> BlockCholesky:
        assert self.factor is not None  # the graph was solved
        return self.factor
