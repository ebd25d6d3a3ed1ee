# SPDX-License-Identifier: BSD-3-Clause
"""Holes among samples, such as those of cabinets: charges in a hole represent sources in it."""

import numpy as np
from scipy.spatial import ConvexHull, QhullError, cKDTree

from magmatch.field.equivalent_sources.shell import SourceShell
from magmatch.field.folds import cube_numbers, has_path_order
from magmatch.grid import spanned_points
from magmatch.typing import Indices, Mask, Points

# Least distance of charges from samples: in median distances of neighbours, beyond which chance leaves few holes, and
# in distances of the layer. Holes as wide as the layer's distance hold charges of the layer itself.
_DISTANCE_IN_NEIGHBOURS, _DISTANCES_IN_LAYERS = 2.4, (0.4, 0.8)
# Spacing of the charges and size of their groups, in that distance.
_STEP, _GROUP = 0.3, 1.0
# Nearer to the layer's own charges than this, in its distances, nothing is added.
_APART = 0.5
# More charges, or a wider lattice to find them on, are not looked at.
_MOST_CHARGES, _MOST_NODES = 1500, 2e6


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
    nodes = nodes[_in_hull(nodes, points)]
    nodes = nodes[cKDTree(shell.sources).query(nodes)[0] > _APART * shell.distance]
    if not 0 < len(nodes) <= _MOST_CHARGES:
        return none
    return np.ascontiguousarray(nodes), cube_numbers(nodes, _GROUP * distance)


def _lattice(points: Points, step: float) -> Points:
    """Nodes within the box of points, none where there would be too many or where it is flat."""
    start, end = points.min(axis=0), points.max(axis=0)
    counts = np.floor((end - start) / step).astype(np.int64)
    if np.any(counts < 1) or np.prod(counts.astype(np.float64)) > _MOST_NODES:
        return np.zeros((0, 3))
    axes = [(a + b - (n - 1) * step) / 2 + step * np.arange(n) for a, b, n in zip(start, end, counts, strict=True)]
    return spanned_points(axes)


def _in_hull(nodes: Points, points: Points) -> Mask:
    """Whether nodes lie in the convex hull of points; none does where all points lie in a plane."""
    try:
        planes = ConvexHull(points).equations
    except QhullError:
        return np.zeros(len(nodes), dtype=np.bool_)
    return np.asarray(np.all(nodes @ planes[:, :3].T + planes[:, 3] <= 0, axis=1))
