# SPDX-License-Identifier: BSD-3-Clause
"""Equivalent sources among or next to the samples, in holes and at magnets, if the evidence supports them.

Small groups of charges are added greedily by their gain in evidence, so that chance holes stay empty and no spurious
magnet is added.
"""

import logging
from dataclasses import dataclass

import numpy as np
from scipy.linalg import cholesky, solve_triangular
from scipy.spatial import cKDTree

from magmatch.field.equivalent_sources.magnets import magnet_charges
from magmatch.field.equivalent_sources.shell import MOST_NODES, SourceShell, charge_design
from magmatch.field.folds import cube_numbers, has_path_order
from magmatch.field.hyperparameters import Hyperparameters
from magmatch.field.spline.spline_prior import CONSTANT_SD
from magmatch.geometry import in_hull
from magmatch.grid import spanned_points
from magmatch.typing import Indices, Mask, Matrix, Points, Scalars, Vectors

log = logging.getLogger(__name__)

# Least distance of charges from samples: in median distances of neighbours, beyond which chance leaves few holes, and
# in distances of the layer. Holes as wide as the layer's distance hold charges of the layer itself.
_DISTANCE_IN_NEIGHBOURS, _DISTANCES_IN_LAYERS = 2.4, (0.4, 0.8)
# Spacing of the charges, in that distance, which is also the size of their groups.
_STEP = 0.3
# Nearer to the layer's own charges than this, in its distances, nothing is added.
_APART = 0.5
# More charges, or a wider lattice to find them on, are not looked at.
_MOST_CHARGES = 1500
# A group must add so many nats; those that add this share of what the best does are taken with it. Along a path so
# many samples may share an error, and count as one.
_LEAST_GAIN, _TOGETHER, _AUTOCORRELATION_TIME = 10.0, 0.5, 16.0
_MOST_ROUNDS = 12


@dataclass(frozen=True, eq=False, slots=True)
class InnerSources:
    """Places where sources may stand nearer than a layer, and the samples' information on them, at any noise."""

    shell: SourceShell
    points: Points  # (n, 3), m: samples
    charges: Points  # (k, 3), m: at magnets, then in holes
    group: Indices  # (k,): which magnet or part of a hole each stands for
    strength: Scalars  # (j,), T m^2: how large those at magnets may be; those in holes are as large as the layer's
    # (m, m): products of all columns, each per unit of charge: the layer's, those of the charges, the constant
    # field's
    gram: Matrix
    product: Scalars  # (m,), T: of the columns with the field

    def filled(self, h: Hyperparameters) -> SourceShell:
        """Layer with those charges that the evidence asks for."""
        if len(self.charges) == 0:
            return self.shell
        unit = h.prior_scale * h.signal_sd
        holes = np.full(len(self.charges) - len(self.strength), self.shell.scale[0])
        scale = np.concatenate([self.strength / unit, holes])
        size = np.concatenate([unit * self.shell.scale, unit * scale, np.full(3, CONSTANT_SD)]) / h.noise_sd
        is_extra = np.zeros(len(size), dtype=np.bool_)
        is_extra[self.shell.n_weights : -3] = True
        gram, y = self.gram * size * size[:, None], self.product * size / h.noise_sd
        least = _LEAST_GAIN * (_AUTOCORRELATION_TIME if has_path_order(self.points) else 1.0)
        taken = _taken(gram, y, is_extra, self.group, least)
        if not taken.any():
            return self.shell
        log.info("%d of %d charges at magnets and in holes among the samples taken", taken.sum(), len(taken))
        return self.shell.with_charges(self.charges[taken], scale[taken], self.points)


def find_inner_sources(shell: SourceShell, points: Points, field: Vectors) -> InnerSources:
    """Look where sources may stand nearer than a layer of charges."""
    magnets, magnet, strength = magnet_charges(points, field, shell.distance)
    holes, hole = hole_charges(shell, points)
    charges = np.concatenate([magnets, holes])
    if len(charges) == 0:
        none = np.zeros((0, 0))
        return InnerSources(shell, points, charges, hole, strength, none, none[0:0].ravel())
    group = np.concatenate([magnet, hole + magnet.max(initial=-1) + 1])
    everything = np.concatenate([shell.sources, charges])
    columns = charge_design(np.ascontiguousarray(points), everything, 0).reshape(-1, len(everything))
    constant = np.kron(np.eye(3), np.ones((len(points), 1)))
    A = np.hstack([columns, constant])
    return InnerSources(shell, points, charges, group, strength, A.T @ A, A.T @ field.T.ravel())


def _taken(gram: Matrix, y: Scalars, is_extra: Mask, group: Indices, least: float) -> Mask:
    """Which further columns add to the evidence, group by group: greedily, against all that was taken before."""
    base, extra = np.flatnonzero(~is_extra), np.flatnonzero(is_extra)
    cross, outer = gram[np.ix_(base, extra)], gram[np.ix_(extra, extra)]
    S, u = _left(gram[np.ix_(base, base)], cross, y[base], outer, y[extra])
    taken = np.zeros(len(group), dtype=np.bool_)
    for _ in range(_MOST_ROUNDS):
        gains = _gains(*_left(S[np.ix_(taken, taken)], S[taken], u[taken], S, u), group)
        gains[np.unique(group[taken])] = -np.inf
        best = float(gains.max())
        if best < least:
            break
        taken |= (gains >= max(least, _TOGETHER * best))[group]
    return taken


def _left(inner: Matrix, cross: Matrix, r: Scalars, outer: Matrix, q: Scalars) -> tuple[Matrix, Scalars]:
    """Reduce the data on outer columns by the part that inner ones, of weights with prior N(0, I), have taken."""
    if len(inner) == 0:
        return outer, q
    L = cholesky(inner + np.eye(len(inner)), lower=True, overwrite_a=True, check_finite=False)
    half = solve_triangular(L, np.column_stack([cross, r]), lower=True, check_finite=False)
    return outer - half[:, :-1].T @ half[:, :-1], q - half[:, :-1].T @ half[:, -1]


def _gains(S: Matrix, u: Scalars, group: Indices) -> Scalars:
    """Compute each group's gain in log evidence: ``u^T (I + S)^-1 u / 2 - log det(I + S) / 2``."""
    gains = np.empty(group.max() + 1)
    for k in range(len(gains)):
        own = np.flatnonzero(group == k)
        L = cholesky(S[np.ix_(own, own)] + np.eye(len(own)), lower=True)
        z = solve_triangular(L, u[own], lower=True)
        gains[k] = 0.5 * z @ z - np.log(np.diag(L)).sum()
    return gains


def hole_charges(shell: SourceShell, points: Points) -> tuple[Points, Indices]:
    """Lattice nodes in the samples' hull, far from samples and a layer of charges: (k, 3), and their groups (k,).

    Paths are excluded: the space between lanes would count as a hole.
    """
    none = np.zeros((0, 3)), np.zeros(0, dtype=np.int64)
    if has_path_order(points):
        return none
    tree = cKDTree(points)
    neighbour = float(np.median(np.asarray(tree.query(points, k=2)[0])[:, 1]))
    low, high = (ratio * shell.distance for ratio in _DISTANCES_IN_LAYERS)
    distance = max(_DISTANCE_IN_NEIGHBOURS * neighbour, low)
    nodes = _lattice(points, _STEP * distance) if distance <= high else none[0]
    nodes = nodes[~np.isfinite(tree.query(nodes, distance_upper_bound=distance)[0])]
    nodes = nodes[in_hull(nodes, points)]
    nodes = nodes[cKDTree(shell.sources).query(nodes)[0] > _APART * shell.distance]
    if not 0 < len(nodes) <= _MOST_CHARGES:
        return none
    return np.ascontiguousarray(nodes), cube_numbers(nodes, distance)


def _lattice(points: Points, step: float) -> Points:
    """Nodes within the box of points, none where there would be too many or where it is flat."""
    start, end = points.min(axis=0), points.max(axis=0)
    counts = np.floor((end - start) / step).astype(np.int64)
    if np.any(counts < 1) or np.prod(counts.astype(np.float64)) > MOST_NODES:
        return np.zeros((0, 3))
    axes = [(a + b - (n - 1) * step) / 2 + step * np.arange(n) for a, b, n in zip(start, end, counts, strict=True)]
    return spanned_points(axes)
