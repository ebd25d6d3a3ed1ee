# SPDX-License-Identifier: BSD-3-Clause
"""Equivalent sources for what stands among the samples: charges in the holes that they leave, where evidence asks.

Nobody measures inside of a cabinet: furniture leaves a hole in a cloud of samples, and charges in that hole stand for
whatever it holds. Small groups of charges are taken one after the other, each for what it adds to the evidence, so
that holes of chance stay empty.
"""

import logging
from dataclasses import replace

import numpy as np
from scipy.linalg import cholesky, solve_triangular
from scipy.spatial import ConvexHull, QhullError, cKDTree

from magmatch.field.held_out import has_path_order
from magmatch.field.hyperparameters import Hyperparameters
from magmatch.field.shell import SourceShell
from magmatch.typing import Indices, Mask, Matrix, Points, Scalars, Vectors

log = logging.getLogger(__name__)

# Least distance of charges from samples: in median distances of neighbours, beyond which chance leaves few holes, and
# in distances of the layer. Holes as wide as the layer's distance hold charges of the layer itself.
_DISTANCE_IN_NEIGHBOURS, _DISTANCES_IN_LAYERS = 2.4, (0.4, 0.8)
# Spacing of the charges and size of the groups that are taken together, in that distance.
_STEP, _GROUP = 0.3, 1.0
# Nearer to the layer's own charges than this, in its distances, nothing is added.
_APART = 0.5
# More charges, or a wider lattice to find them on, are not looked at.
_MOST_CHARGES, _MOST_NODES = 1500, 2e6
# A group must add so many nats; those that add this share of what the best does are taken with it.
_LEAST_GAIN, _TOGETHER = 10.0, 0.5
_MOST_ROUNDS = 12


def fill_holes(
    shell: SourceShell, points: Points, field: Vectors, h: Hyperparameters, constant_sd: float
) -> SourceShell:
    """Layer of charges with more of them in those holes of the samples where the data show sources.

    Parameters
    ----------
    shell : SourceShell
    points : (n, 3) array, m
    field : (n, 3) array, T
    h : Hyperparameters
        Signal and noise of the layer.
    constant_sd : float, T
        Prior standard deviation of the constant field.

    Returns
    -------
    SourceShell
        The same where there are no holes, no need, or where samples lie along a path: there evidence takes shared
        errors for field, and whatever lies between lanes would be a hole.
    """
    if has_path_order(points):
        return shell
    charges, distance = _candidates(shell, points)
    if len(charges) == 0:
        return shell
    group = _groups(charges, _GROUP * distance)
    design = _whitened(shell, points, h, constant_sd)
    extra = replace(shell, sources=charges).everywhere(points) * (h.looseness * h.signal_sd / h.noise_sd)
    taken = _taken(design, extra, (field / h.noise_sd).T.ravel(), group)
    log.info("%d of %d charges in holes among the samples taken", taken.sum(), len(taken))
    return shell.with_holes(charges[taken], distance) if taken.any() else shell


def _candidates(shell: SourceShell, points: Points) -> tuple[Points, float]:
    """Lattice nodes within the samples' hull, far from any sample and from the layer, and how far from samples."""
    none = np.zeros((0, 3))
    tree = cKDTree(points)
    neighbour = float(np.median(np.asarray(tree.query(points, k=2)[0])[:, 1]))
    low, high = (ratio * shell.distance for ratio in _DISTANCES_IN_LAYERS)
    distance = max(_DISTANCE_IN_NEIGHBOURS * neighbour, low)
    if distance > high:
        return none, distance
    step = _STEP * distance
    start, end = points.min(axis=0), points.max(axis=0)
    counts = np.floor((end - start) / step).astype(np.int64)
    if np.any(counts < 1) or np.prod(counts.astype(np.float64)) > _MOST_NODES:
        return none, distance
    axes = [(a + b - (n - 1) * step) / 2 + step * np.arange(n) for a, b, n in zip(start, end, counts, strict=True)]
    nodes = np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1).reshape(-1, 3)
    nodes = nodes[~np.isfinite(tree.query(nodes, distance_upper_bound=distance)[0])]
    nodes = nodes[_in_hull(nodes, points)]
    nodes = nodes[cKDTree(shell.sources).query(nodes)[0] > _APART * shell.distance]
    return (np.ascontiguousarray(nodes) if len(nodes) <= _MOST_CHARGES else none), distance


def _in_hull(nodes: Points, points: Points) -> Mask:
    """Whether nodes lie in the convex hull of points; none does where all points lie in a plane."""
    try:
        planes = ConvexHull(points).equations
    except QhullError:
        return np.zeros(len(nodes), dtype=np.bool_)
    return np.asarray(np.all(nodes @ planes[:, :3].T + planes[:, 3] <= 0, axis=1))


def _groups(charges: Points, size: float) -> Indices:
    """Number the cubes that hold charges."""
    cube = np.floor((charges - charges.min(axis=0)) / size).astype(np.int64)
    return np.asarray(np.unique(cube, axis=0, return_inverse=True)[1].reshape(-1), dtype=np.int64)


def _whitened(shell: SourceShell, points: Points, h: Hyperparameters, constant_sd: float) -> Matrix:
    """Field in units of the noise per unit of each whitened weight, the constant's last: (3 n, m + 3)."""
    basis = shell.everywhere(points) * (h.looseness * h.signal_sd / h.noise_sd)
    return np.hstack([basis, np.kron(constant_sd / h.noise_sd * np.eye(3), np.ones((len(points), 1)))])


def _taken(design: Matrix, extra: Matrix, y: Scalars, group: Indices) -> Mask:
    """Which further columns add to the evidence, group by group: greedily, against all that was taken before."""
    base = design.T @ design
    S, u = _left(base, design.T @ extra, design.T @ y, extra.T @ extra, extra.T @ y)
    taken = np.zeros(len(group), dtype=np.bool_)
    for _ in range(_MOST_ROUNDS):
        gains = _gains(*_left(S[np.ix_(taken, taken)], S[taken], u[taken], S, u), group)
        gains[np.unique(group[taken])] = -np.inf
        best = float(gains.max())
        if best < _LEAST_GAIN:
            break
        taken |= (gains >= max(_LEAST_GAIN, _TOGETHER * best))[group]
    return taken


def _left(inner: Matrix, cross: Matrix, r: Scalars, outer: Matrix, q: Scalars) -> tuple[Matrix, Scalars]:
    """What data say about outer columns once inner ones, of weights with prior N(0, I), have taken their part."""
    if len(inner) == 0:
        return outer, q
    L = cholesky(inner + np.eye(len(inner)), lower=True, overwrite_a=True, check_finite=False)
    half = solve_triangular(L, np.column_stack([cross, r]), lower=True, check_finite=False)
    return outer - half[:, :-1].T @ half[:, :-1], q - half[:, :-1].T @ half[:, -1]


def _gains(S: Matrix, u: Scalars, group: Indices) -> Scalars:
    """What each group of columns adds to the log evidence: ``u^T (I + S)^-1 u / 2 - log det(I + S) / 2``."""
    gains = np.empty(group.max() + 1)
    for k in range(len(gains)):
        own = np.flatnonzero(group == k)
        L = cholesky(S[np.ix_(own, own)] + np.eye(len(own)), lower=True)
        z = solve_triangular(L, u[own], lower=True)
        gains[k] = 0.5 * z @ z - np.log(np.diag(L)).sum()
    return gains
