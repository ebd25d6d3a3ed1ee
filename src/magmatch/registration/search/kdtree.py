# SPDX-License-Identifier: BSD-3-Clause
"""Nearest neighbours among many points, by a balanced k-d tree stored in arrays.

The arrays can be memory-mapped from a file, so that a table of a hundred thousand pairs is ready at once, and a query
reads only the leaves that it visits.
"""

from dataclasses import dataclass

import numpy as np

from magmatch.compiled import allocating, compiled, subroutine
from magmatch.estimation.limits import LEAF
from magmatch.typing import Indices, Matrix

# More than any tree has.
EVERY_LEAF = np.iinfo(np.int64).max


@dataclass(frozen=True, eq=False, slots=True)
class NeighbourTree:
    """Points in the order of the tree's leaves, and the planes that divide them."""

    points: np.ndarray  # (n, d) float32: leaf by leaf
    rows: np.ndarray  # (n,) int32: row of each among the points given
    axes: np.ndarray  # (m,) int32: axis that each inner node splits; node k has children 2 k + 1 and 2 k + 2
    values: np.ndarray  # (m,) float32: coordinate of each split

    @classmethod
    def of(cls, points: np.ndarray) -> "NeighbourTree":
        """Divide points at their medians until leaves are small."""
        points = np.array(points, dtype=np.float32, order="C")
        n, depth = len(points), 0
        while n >> depth > LEAF:
            depth += 1
        rows = np.arange(n, dtype=np.int32)
        axes, values = np.zeros((1 << depth) - 1, dtype=np.int32), np.zeros((1 << depth) - 1, dtype=np.float32)
        bounds = np.zeros((2 * len(axes) + 1, 2), dtype=np.int64)
        bounds[0, 1] = n
        _divide(points, rows, axes, values, bounds)
        return cls(points, rows, axes, values)

    def query(self, targets: np.ndarray, k: int, n_leaves: int = EVERY_LEAF) -> tuple[Indices, Matrix]:
        """Rows (t, k) of the k nearest points of each target, nearest first, and their squared distances.

        At most ``n_leaves`` are looked into for each: with few, points that are near, not always the nearest.
        """
        targets = np.ascontiguousarray(targets, dtype=np.float32)
        if k > len(self.points):
            msg = f"expected at most as many neighbours as points ({len(self.points)}), got {k}"
            raise ValueError(msg)
        found = np.zeros((len(targets), k), dtype=np.int64)
        distance2 = np.full((len(targets), k), np.inf)
        _query(self.points, self.axes, self.values, targets, n_leaves, found, distance2)
        return np.asarray(self.rows[found], dtype=np.int64), distance2


@subroutine
def _halve(points, rows, axis, first, middle, last):  # type: ignore[no-untyped-def]
    """Quickselect: what precedes the middle is less along an axis; of equal coordinates the first row is the less."""
    while first < last:
        i, j = first, last
        x, row = points[(first + last) // 2, axis], rows[(first + last) // 2]
        while i <= j:
            while points[i, axis] < x or (points[i, axis] == x and rows[i] < row):
                i += 1
            while points[j, axis] > x or (points[j, axis] == x and rows[j] > row):
                j -= 1
            if i <= j:
                for c in range(points.shape[1]):
                    points[i, c], points[j, c] = points[j, c], points[i, c]
                rows[i], rows[j] = rows[j], rows[i]
                i, j = i + 1, j - 1
        # If the middle lies between j and i, it is in its place.
        first, last = first if middle <= j else i, last if middle >= i else j


@compiled
def _divide(points, rows, axes, values, bounds):  # type: ignore[no-untyped-def]
    """Bring points and rows into the order of leaves; ``bounds`` has a row for each node, that of the root set."""
    for node in range(len(axes)):
        low, high = bounds[node, 0], bounds[node, 1]
        middle, axis, widest = (low + high) // 2, 0, np.float32(-1.0)
        for c in range(points.shape[1]):
            least = most = points[low, c]
            for p in range(low + 1, high):
                least, most = min(least, points[p, c]), max(most, points[p, c])
            if most - least > widest:
                axis, widest = c, most - least
        _halve(points, rows, axis, low, middle, high - 1)
        axes[node], values[node] = axis, points[middle, axis]
        bounds[2 * node + 1, 0], bounds[2 * node + 1, 1] = low, middle
        bounds[2 * node + 2, 0], bounds[2 * node + 2, 1] = middle, high


@allocating
def _query(points, axes, values, targets, n_leaves, found, distance2):  # type: ignore[no-untyped-def]
    n, d = points.shape
    k, n_inner, depth = found.shape[1], len(axes), 1
    while n_inner >> depth:
        depth += 1
    # One node waits at each level, at most, and the one in hand.
    nodes, lows, highs = np.zeros(depth + 1, np.int64), np.zeros(depth + 1, np.int64), np.zeros(depth + 1, np.int64)
    # Distance from the target to each waiting node's box, axis by axis.
    gaps, gap = np.zeros((depth + 1, d)), np.zeros(d)
    for t in range(len(targets)):
        near, n_left = distance2[t], n_leaves
        nodes[0], lows[0], highs[0], n_waiting = 0, 0, n, 1
        for c in range(d):
            gaps[0, c] = 0.0
        while n_waiting and n_left > 0:
            n_waiting -= 1
            node, low, high = nodes[n_waiting], lows[n_waiting], highs[n_waiting]
            gap2 = 0.0
            for c in range(d):
                gap[c] = gaps[n_waiting, c]
                gap2 += gap[c] * gap[c]
            if gap2 >= near[k - 1]:
                continue
            while node < n_inner:
                axis, middle = axes[node], (low + high) // 2
                beyond = np.float64(targets[t, axis]) - values[node]
                nodes[n_waiting] = 2 * node + 1 + (beyond < 0)
                for c in range(d):
                    gaps[n_waiting, c] = gap[c]
                lows[n_waiting], highs[n_waiting] = (middle, high) if beyond < 0 else (low, middle)
                gaps[n_waiting, axis] = max(abs(beyond), gap[axis])
                n_waiting += 1
                node = 2 * node + 1 + (beyond >= 0)
                low, high = (low, middle) if beyond < 0 else (middle, high)
            n_left -= 1
            for p in range(low, high):
                d2 = 0.0
                for c in range(d):
                    d2 += (np.float64(points[p, c]) - targets[t, c]) ** 2
                if d2 < near[k - 1]:
                    at = k - 1
                    while at > 0 and near[at - 1] > d2:
                        near[at], found[t, at] = near[at - 1], found[t, at - 1]
                        at -= 1
                    near[at], found[t, at] = d2, p
