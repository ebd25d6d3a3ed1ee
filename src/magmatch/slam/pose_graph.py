# SPDX-License-Identifier: BSD-3-Clause
"""Nodes tied by odometry and closures, solved by sparse least squares that weighs closures by whether they hold.

A node's perturbation is ``T Exp(xi)`` with the turn and the shift apart: R Exp(phi), p + R rho. Odometry says how the
next node lies, up to a random walk and two lasting errors a log, scale and turn rate. A closure counts as much as it
is likely right, given its probability and how far the rest of the graph contradicts it (a mixture of right and wrong,
by expectation and maximisation).
"""

from dataclasses import dataclass, field, replace

import numpy as np
from scipy.sparse import coo_array, csc_array
from scipy.sparse.linalg import SuperLU, splu
from scipy.spatial.transform import RigidTransform, Rotation

from magmatch.geometry import adjoint, skew
from magmatch.slam.config import SlamConfig
from magmatch.typing import Covariance6, Indices, Matrix, Points, Tensors

N_LASTING = 2
# Of what nobody doubts: the first node of a component, and directions in which odometry does not drift.
SURE = 1e-4
# How well gravity and one floor hold at a node: rad, m.
UPRIGHT_SD, LEVEL_SD = 0.01, 0.05
# Gauss-Newton: most steps, those before closures are doubted, and the step that ends it.
MOST_STEPS, TRUSTING_STEPS, SMALL = 40, 5, 1e-4
# Nodes whose covariance is computed at once.
COLUMNS = 32
# Nobody is surer of a closure than this, nats: else none could be voted out.
MOST_ODDS = 12.0
# Columns, Jacobian, information and residual of many rows alike.
Part = tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]


@dataclass(frozen=True, eq=False, slots=True)
class Edges:
    """Odometry between neighbouring nodes: shift (e, 3), covariance (e, 6, 6), lasting errors (e, 6, 2), log (e,)."""

    first: Indices
    second: Indices
    shift: Points
    covariance: Tensors
    lasting: np.ndarray
    log: Indices


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
        That it is right, before the graph was asked.
    weight : float
        How likely it is right once the graph was.
    """

    first: int
    second: int
    T_first_second: RigidTransform
    covariance: Covariance6
    log_odds: float
    weight: float = 1.0

    @property
    def is_kept(self) -> bool:
        """Whether the graph believes it: what it also takes to tie two logs."""
        return self.weight > 0.5


@dataclass(eq=False)
class PoseGraph:
    """Poses of all nodes, and what ties them.

    Attributes
    ----------
    R, p : (n, 3, 3) and (n, 3) arrays
        Nodes in the frame of their component.
    log : (n,) int array
        Of each node.
    lasting : (logs, 2) array
        Estimated scale (a share) and turn rate (rad/m) of each log's odometry.
    """

    config: SlamConfig
    R: Tensors
    p: Points
    log: Indices
    edges: Edges
    closures: list[Closure] = field(default_factory=list)
    lasting: Matrix = field(default_factory=lambda: np.zeros((0, 2)))
    _lu: SuperLU | None = None
    _own: np.ndarray | None = None

    def __post_init__(self) -> None:
        self.start = self.p.copy()
        if not len(self.lasting):
            self.lasting = np.zeros((int(self.log.max()) + 1, N_LASTING))

    def component(self) -> Indices:
        """First log of the logs that closures tie to each node's log."""
        root = np.arange(len(self.lasting))
        for c in self.closures:
            if c.is_kept:
                a, b = root[self.log[c.first]], root[self.log[c.second]]
                root[root == max(a, b)] = min(a, b)
        found: Indices = root[self.log].astype(np.int64)
        return found

    def solve(self) -> None:
        """Most likely poses; closures that the rest contradicts lose their weight."""
        for step in range(MOST_STEPS):
            H, v = self._normal_equations()
            # Symmetric and positive definite: pivots stay on the diagonal.
            symmetric = {"SymmetricMode": True}
            self._lu = splu(csc_array(H), permc_spec="MMD_AT_PLUS_A", diag_pivot_thresh=0.0, options=symmetric)
            self._own = None
            xi = -self._lu.solve(v)
            n = len(self.p)
            turns, shifts = np.split(xi[: 6 * n].reshape(n, 6), 2, axis=1)
            largest = np.abs(turns).max()
            if largest > 0.3:
                turns, shifts, xi = turns * 0.3 / largest, shifts * 0.3 / largest, xi * 0.3 / largest
            self.p = self.p + np.einsum("nij,nj->ni", self.R, shifts)
            self.R = self.R @ Rotation.from_rotvec(turns).as_matrix()
            self.lasting = self.lasting + xi[6 * n :].reshape(-1, N_LASTING)
            if step >= TRUSTING_STEPS:
                self._doubt()
            if np.abs(xi).max() < SMALL and (step > TRUSTING_STEPS + 1 or not self.closures):
                break

    def forget_closures(self) -> None:
        """Back to odometry alone."""
        self.closures.clear()
        self.p, self.R = self.start.copy(), np.tile(np.eye(3), (len(self.p), 1, 1))
        self.lasting = np.zeros_like(self.lasting)
        self.solve()

    def _doubt(self) -> None:
        if not self.closures:
            return
        _, _, r, _, _, P = self._closure_rows()
        chi2 = np.einsum("ei,eij,ej->e", r, P, r)
        for k, c in enumerate(self.closures):
            odds = min(c.log_odds, MOST_ODDS) - 0.5 * max(chi2[k] - 6.0, 0.0)
            self.closures[k] = replace(c, weight=float(1 / (1 + np.exp(-np.clip(odds, -60, 60)))))

    def pose(self, k: int) -> RigidTransform:
        """Of a node in its component's frame."""
        return RigidTransform.from_components(self.p[k], Rotation.from_matrix(self.R[k]))

    def center(self, k: int) -> RigidTransform:
        """Of a node in its log's own frame, as odometry has it."""
        return RigidTransform.from_translation(self.start[k])

    def odometry(self, k: int) -> tuple[RigidTransform, Covariance6]:
        """From a node to the next of its log, and its covariance."""
        e = int(np.searchsorted(self.edges.first, k))
        o, L = self.config.odometry, self.edges.lasting[e]
        lasting = L @ np.diag([o.scale_sd**2, o.turn_rate_sd**2]) @ L.T
        return RigidTransform.from_translation(self.edges.shift[e]), self.edges.covariance[e] + lasting

    def relative_covariances(self, firsts: Indices, second: int) -> np.ndarray:
        """Of ``T_first_second Exp(xi)`` about the second node, for each first node: (f, 6, 6)."""
        assert self._lu is not None
        C_as = self._columns(np.array([second])).reshape(-1, 6, 6)
        # How a perturbation of each first node moves the second, in the second's axes.
        T_second = self.pose(second).inv()
        A = np.stack([adjoint(T_second * self.pose(int(first))) for first in firsts])
        AC = A @ C_as[firsts]
        found = C_as[second] + A @ self.marginals()[firsts] @ np.swapaxes(A, 1, 2) - AC - np.swapaxes(AC, 1, 2)
        return np.asarray((found + np.swapaxes(found, 1, 2)) / 2)

    def _columns(self, nodes: Indices) -> Matrix:
        """Covariance of all nodes with some: (6 n, 6 k)."""
        assert self._lu is not None
        columns = np.zeros((6 * len(self.p) + self.lasting.size, 6 * len(nodes)))
        columns[_six(nodes).ravel(), np.arange(6 * len(nodes))] = 1.0
        return np.asarray(self._lu.solve(columns)[: 6 * len(self.p)])

    def marginals(self) -> np.ndarray:
        """Covariance of each node: (n, 6, 6)."""
        if self._own is None:
            n, found = len(self.p), []
            for some in np.array_split(np.arange(n), max(n // COLUMNS, 1)):
                C = self._columns(some).reshape(n, 6, len(some), 6)
                found.append(C[some, :, np.arange(len(some))])
            self._own = np.concatenate(found)
        return self._own

    def _normal_equations(self) -> tuple[coo_array, np.ndarray]:
        size = 6 * len(self.p) + self.lasting.size
        e, parts = self.edges, self._alone()
        if len(e.first):
            turn = np.einsum("eij,ej->ei", e.lasting, self.lasting[e.log])
            Z = Rotation.from_rotvec(turn[:, :3]).as_matrix(), e.shift + turn[:, 3:]
            r, Ji, Jj = self._between(e.first, e.second, *Z)
            cols = np.concatenate([_six(e.first), _six(e.second), self._lasting_columns(e.log)], axis=1)
            parts.append((cols, np.concatenate([Ji, Jj, -e.lasting], axis=2), np.linalg.inv(e.covariance), r))
        if self.closures:
            i, j, r, Ji, Jj, P = self._closure_rows()
            weight = np.array([c.weight for c in self.closures])
            cols = np.concatenate([_six(i), _six(j)], axis=1)
            parts.append((cols, np.concatenate([Ji, Jj], axis=2), P * weight[:, None, None], r))
        rows, columns, values, v = [], [], [], np.zeros(size)
        for cols, J, P, r in parts:
            H = np.swapaxes(J, 1, 2) @ P @ J
            k = cols.shape[1]
            rows.append(np.repeat(cols, k, axis=1).ravel())
            columns.append(np.tile(cols, (1, k)).ravel())
            values.append(H.ravel())
            np.add.at(v, cols.ravel(), (np.swapaxes(J, 1, 2) @ (P @ r[:, :, None])).ravel())
        at = (np.concatenate(rows), np.concatenate(columns))
        return coo_array((np.concatenate(values), at), shape=(size, size)), v

    def _lasting_columns(self, logs: Indices) -> np.ndarray:
        return np.asarray(6 * len(self.p) + N_LASTING * logs[:, None] + np.arange(N_LASTING))

    def _alone(self) -> list[Part]:
        """What is known of single nodes: up, height, where a component begins; and of lasting errors."""
        n, c = len(self.p), self.config
        every = np.arange(n)
        found: list[Part] = []
        if c.is_gravity_aligned:
            up = self.R[:, 2, :]  # the map's vertical in the node's axes
            J = np.concatenate([skew(up), np.zeros((n, 3, 3))], axis=2)
            found.append((_six(every), J, _alike(np.eye(3) / UPRIGHT_SD**2, n), up - [0.0, 0.0, 1.0]))
        if c.is_planar:
            J = np.concatenate([np.zeros((n, 3)), self.R[:, 2, :]], axis=1)[:, None, :]
            off = (self.p[:, 2] - self.start[:, 2])[:, None]
            found.append((_six(every), J, _alike(np.eye(1) / LEVEL_SD**2, n), off))
        first = np.unique(self.component(), return_index=True)[1]
        k = len(first)
        found.append((_six(first), _alike(np.eye(6), k), _alike(np.eye(6) / SURE**2, k), np.zeros((k, 6))))
        sd, k = np.maximum([c.odometry.scale_sd, c.odometry.turn_rate_sd], 1e-9), len(self.lasting)
        columns = self._lasting_columns(np.arange(k))
        found.append((columns, _alike(np.eye(2), k), _alike(np.diag(sd**-2), k), self.lasting))
        return found

    def _closure_rows(self) -> tuple[np.ndarray, ...]:
        i, j = (np.array([getattr(c, name) for c in self.closures]) for name in ("first", "second"))
        Z = [c.T_first_second.as_matrix() for c in self.closures]
        R, t = np.stack([z[:3, :3] for z in Z]), np.stack([z[:3, 3] for z in Z])
        r, Ji, Jj = self._between(i, j, R, t)
        # Their covariance is stated in the second node's axes.
        turn = np.zeros((len(i), 6, 6))
        turn[:, :3, :3], turn[:, 3:, 3:] = np.eye(3), R
        C = np.stack([c.covariance for c in self.closures])
        return i, j, r, Ji, Jj, np.linalg.inv(turn @ C @ np.swapaxes(turn, 1, 2))

    def _between(self, i: Indices, j: Indices, R: Tensors, t: Points) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Residual of ``T_i^-1 T_j`` against (R, t), and its slopes with both nodes."""
        Ri, Rj = self.R[i], self.R[j]
        Rij = np.swapaxes(Ri, 1, 2) @ Rj
        tij = np.einsum("eji,ej->ei", Ri, self.p[j] - self.p[i])
        r = np.concatenate([Rotation.from_matrix(np.swapaxes(R, 1, 2) @ Rij).as_rotvec(), tij - t], axis=1)
        bend = np.eye(3) + 0.5 * skew(r[:, :3])
        Ji, Jj = np.zeros((len(i), 6, 6)), np.zeros((len(i), 6, 6))
        Ji[:, :3, :3], Jj[:, :3, :3] = -bend @ np.swapaxes(Rij, 1, 2), bend
        Ji[:, 3:, :3], Ji[:, 3:, 3:], Jj[:, 3:, 3:] = skew(tij), -np.eye(3), Rij
        return r, Ji, Jj


def _alike(M: Matrix, n: int) -> np.ndarray:
    return np.broadcast_to(M, (n, *M.shape))


def _six(nodes: np.ndarray) -> np.ndarray:
    return 6 * nodes[:, None] + np.arange(6)
