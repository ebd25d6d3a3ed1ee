# SPDX-License-Identifier: BSD-3-Clause
"""Nodes tied by odometry and closures, solved by sparse least squares that weighs closures by whether they hold.

A node's perturbation is ``T Exp(xi)`` with the turn and the shift apart: R Exp(phi), p + R rho. Odometry says how the
next node lies, up to a random walk and two lasting errors a log, scale and turn rate. A closure counts as much as it
is likely right, given its probability and how far the rest of the graph contradicts it (a mixture of right and wrong,
by expectation and maximisation).
"""

from dataclasses import dataclass, field, fields, replace

import numpy as np
from scipy.sparse import coo_array, csc_array
from scipy.sparse.linalg import SuperLU
from scipy.spatial.transform import RigidTransform, Rotation

from magmatch.geometry import skew
from magmatch.slam.config import SlamConfig
from magmatch.slam.graph.selected_inverse import factorised, inverse_blocks
from magmatch.typing import Covariance6, Indices, Matrix, Points, Scalars, Tensors

N_LASTING = 2
# Of what nobody doubts: the first node of a component, and directions in which odometry does not drift.
SURE = 1e-4
# Of what fixed points need not tell, such as where the frame of a single one points to: rad, m.
FREE = 1e3
# Standard deviations beyond which a difference is one, or is looked for.
REACH = 3.0
UP = np.array([0.0, 0.0, 1.0])
# How well gravity and one floor hold at a node: rad, m.
UPRIGHT_SD, LEVEL_SD = 0.01, 0.05
# Gauss-Newton: most steps, those before closures are doubted, and the step that ends it.
MOST_STEPS, TRUSTING_STEPS, SMALL = 40, 5, 1e-4
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
    fixed : FixedPoints, optional
        Where they are known, a component has no frame of its own.
    """

    config: SlamConfig
    R: Tensors = field(default_factory=lambda: np.zeros((0, 3, 3)))
    p: Points = field(default_factory=lambda: np.zeros((0, 3)))
    log: Indices = field(default_factory=lambda: np.zeros(0, np.int64))
    edges: Edges = field(default_factory=Edges.none)
    closures: list[Closure] = field(default_factory=list)
    lasting: Matrix = field(default_factory=lambda: np.zeros((0, 2)))
    fixed: FixedPoints | None = None
    _H: csc_array | None = None
    _lu: SuperLU | None = None
    _own: np.ndarray | None = None

    def __post_init__(self) -> None:
        self.start, self.level = self.p.copy(), self.p[:, 2].copy()
        if not len(self.lasting):
            self.lasting = np.zeros((int(self.log.max(initial=-1)) + 1, N_LASTING))

    def grow(self, centers: Points, logs: Indices, edges: Edges) -> None:
        """Add nodes at the end: where odometry leads from those before, or in a frame of their own."""
        self.edges = self.edges.with_more(edges)
        self.log = np.concatenate([self.log, logs])
        self.start = np.concatenate([self.start, centers])
        self.p, self.R = np.concatenate([self.p, centers]), np.concatenate([self.R, _alike(np.eye(3), len(centers))])
        self.lasting = np.concatenate([self.lasting, np.zeros((int(self.log.max()) + 1 - len(self.lasting), 2))])
        self.level = np.concatenate([self.level, centers[:, 2]])
        for i, j, shift in zip(edges.first, edges.second, edges.shift, strict=True):
            self.R[j], self.p[j] = self.R[i], self.p[i] + self.R[i] @ shift
            self.level[j] = self.level[i] + shift[2]

    def component(self) -> Indices:
        """First log of the logs that share each node's frame: by closures, or by fixed points that tell the frame."""
        root = self._tied()
        told = [r for r, rows in self._fixed_by(root).items() if self.tell_the_frame(rows)]
        root[np.isin(root, told)] = min(told, default=0)
        found: Indices = root[self.log].astype(np.int64)
        return found

    def _tied(self) -> Indices:
        """First log of the logs that closures tie to each log."""
        root = np.arange(len(self.lasting))
        for c in self.closures:
            if c.is_kept:
                a, b = root[self.log[c.first]], root[self.log[c.second]]
                root[root == max(a, b)] = min(a, b)
        return root

    def _fixed_by(self, root: Indices) -> dict[int, Indices]:
        """Fixed points of each group of logs that has any."""
        if self.fixed is None:
            return {}
        of = root[self.log[self.fixed.one]]
        return {int(r): np.flatnonzero(of == r) for r in np.unique(of)}

    def tell_the_frame(self, rows: Indices) -> bool:
        """Whether fixed points lie so far apart, against their sd, that they leave no turn open."""
        assert self.fixed is not None
        apart = (self.fixed.position[rows] - self.fixed.position[rows].mean(axis=0)) / self.fixed.sd[rows, None]
        upright = self.config.is_gravity_aligned
        lengths = np.linalg.svd(apart[:, :2] if upright else apart, compute_uv=False)
        # About the vertical one direction tells the turn, in space it takes two.
        return bool(lengths[0 if upright else 1 :].max(initial=0.0) > REACH)

    def is_fixed(self, node: int) -> bool:
        """Whether fixed points tell the frame that a node is in."""
        component = self.component()
        rows = self._fixed_by(component[np.unique(self.log, return_index=True)[1]])
        return any(r == component[node] and self.tell_the_frame(some) for r, some in rows.items())

    def _bring_to_fixed(self) -> None:
        """Move what closures tie, as a whole, to its fixed points: least squares must begin near its answer."""
        if self.fixed is None:
            return
        f, root = self.fixed, self._tied()
        seen = self._seen_at_fixed()[0]
        for r, rows in self._fixed_by(root).items():
            w = f.sd[rows] ** -2
            a, b = (np.average(points[rows], axis=0, weights=w) for points in (seen, f.position))
            R = np.eye(3)
            if self.tell_the_frame(rows):
                x, y = seen[rows] - a, f.position[rows] - b
                if self.config.is_gravity_aligned:
                    x, y = x * [1, 1, 0], y * [1, 1, 0]
                    # What holds the vertical: a pair of vectors along it that outweighs the rest.
                    x, y, w = np.vstack([x, UP]), np.vstack([y, UP]), np.append(w, np.inf)
                R = Rotation.align_vectors(y, x, weights=w)[0].as_matrix()
            mine = root[self.log] == r
            self.R[mine], self.p[mine] = R @ self.R[mine], (self.p[mine] - a) @ R.T + b
            self.level[mine] = self.start[mine, 2] + np.mean(self.p[mine, 2] - self.start[mine, 2])

    def _seen_at_fixed(self) -> tuple[np.ndarray, np.ndarray]:
        """Where the graph has the fixed points (a, 3), and the slopes with both nodes of each (a, 3, 12)."""
        f = self.fixed
        assert f is not None
        seen, slopes = np.zeros((len(f.sd), 3)), []
        for nodes, share in ((f.one, 1 - f.share), (f.other, f.share)):
            arm = f.x - self.start[nodes]
            seen += share[:, None] * (self.p[nodes] + np.einsum("nij,nj->ni", self.R[nodes], arm))
            slopes += [-share[:, None, None] * self.R[nodes] @ skew(arm), share[:, None, None] * self.R[nodes]]
        return seen, np.concatenate(slopes, axis=2)

    def off_fixed(self) -> Points:
        """How far the graph leaves each fixed point from where it should be: (a, 3), m."""
        return np.zeros((0, 3)) if self.fixed is None else self._seen_at_fixed()[0] - self.fixed.position

    def solve(self) -> None:
        """Most likely poses; closures that the rest contradicts lose their weight."""
        self._bring_to_fixed()
        doubts_from = TRUSTING_STEPS
        for step in range(MOST_STEPS):
            H, v = self._normal_equations()
            self._H, self._own = csc_array(H), None
            self._lu = factorised(self._H)
            xi = -self._lu.solve(v)
            n = len(self.p)
            turns, shifts = np.split(xi[: 6 * n].reshape(n, 6), 2, axis=1)
            largest = np.abs(turns).max()
            if largest > 0.3:
                # Still on the way: what seems contradicted now need not be in the end.
                doubts_from = step + 1 + TRUSTING_STEPS
                turns, shifts, xi = turns * 0.3 / largest, shifts * 0.3 / largest, xi * 0.3 / largest
            self.p = self.p + np.einsum("nij,nj->ni", self.R, shifts)
            self.R = self.R @ Rotation.from_rotvec(turns).as_matrix()
            self.lasting = self.lasting + xi[6 * n :].reshape(-1, N_LASTING)
            if step >= doubts_from:
                self._doubt()
            if np.abs(xi).max() < SMALL and (step > doubts_from + 1 or not self.closures):
                break
        self._bring_home()

    def _bring_home(self) -> None:
        """Logs whose last closure was voted out go back to a frame of their own."""
        component = self.component()
        names, first = np.unique(component, return_index=True)
        fixed = [] if self.fixed is None else component[self.fixed.one].tolist()
        for name, k in zip(names.tolist(), first.tolist(), strict=True):
            if name not in fixed and np.abs(self.p[k] - self.start[k]).max() > SMALL:
                R, mine = self.R[k].T, component == name
                self.R[mine], self.p[mine] = R @ self.R[mine], (self.p[mine] - self.p[k]) @ R.T + self.start[k]

    def forget_closures(self) -> None:
        """Back to odometry alone."""
        self.closures.clear()
        self.level = self.start[:, 2].copy()
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
        # How a perturbation of each first node moves the second, in the second's axes: the adjoint of where it is.
        R = self.R[second].T @ self.R[firsts]
        A = np.zeros((len(firsts), 6, 6))
        A[:, :3, :3] = A[:, 3:, 3:] = R
        A[:, 3:, :3] = skew((self.p[firsts] - self.p[second]) @ self.R[second]) @ R
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
            assert self._lu is not None
            assert self._H is not None
            self._own = inverse_blocks(self._H, self._lu, len(self.p), 6)
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
            # What ties two components no more pulls at neither.
            component = self.component()
            weight = np.array([c.weight for c in self.closures]) * (component[i] == component[j])
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
            off = (self.p[:, 2] - self.level)[:, None]
            found.append((_six(every), J, _alike(np.eye(1) / LEVEL_SD**2, n), off))
        component = self.component()
        names, first = np.unique(component, return_index=True)
        k = len(first)
        has_fixed = np.isin(names, component[self.fixed.one] if self.fixed is not None else names[:0])
        sure = np.where(has_fixed, FREE, SURE)[:, None, None]
        found.append((_six(first), _alike(np.eye(6), k), np.eye(6) / sure**2, np.zeros((k, 6))))
        if self.fixed is not None:
            f, columns = self.fixed, np.concatenate([_six(self.fixed.one), _six(self.fixed.other)], axis=1)
            seen, J = self._seen_at_fixed()
            found.append((columns, J, np.eye(3) / f.sd[:, None, None] ** 2, seen - f.position))
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
