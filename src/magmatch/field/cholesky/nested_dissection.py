# SPDX-License-Identifier: BSD-3-Clause
"""The order of elimination: halves of the region first, the plane of nodes between them last, over and over.

A separator is three nodes thick (as far as splines reach), so its two sides never meet in the factor. Each part of
the tree becomes a front: the unknowns it eliminates and the later ones they touch. The constant field comes last.
"""

from dataclasses import dataclass

import numpy as np

from magmatch.field.cholesky.cells import STENCIL_REACH, CellGrid

LEAF_SIZE = 200
# A cut must leave at least this share of the nodes on its smaller side, and cost less than the share of them below.
SMALLEST_SIDE = 0.2
LARGEST_SEPARATOR = 0.6


@dataclass(frozen=True, eq=False, slots=True)
class Front:
    """One dense step of the elimination."""

    start: int  # positions of the unknowns eliminated here
    stop: int
    border: np.ndarray  # (k,): positions of later unknowns that they touch, ascending
    # Fronts whose updates are added here, and in ``child_rows`` to which rows of ``unknowns``
    children: tuple[int, ...]
    child_rows: tuple[np.ndarray, ...]
    unknowns: np.ndarray  # (n,): which unknowns stand at ``start..stop`` followed by ``border``


@dataclass(frozen=True, eq=False, slots=True)
class Elimination:
    """Order and fronts of the factorisation of a `StencilMatrix` over given cells."""

    cells: CellGrid
    position: np.ndarray  # (m + 3,): place of each unknown in the order; the constant's come last
    unknown: np.ndarray  # (m + 3,): the reverse: which unknown stands at each place
    fronts: list[Front]  # children before parents; the last one is the root

    @property
    def n_unknowns(self) -> int:
        """Size of the matrix."""
        return len(self.position)

    @property
    def branches(self) -> tuple[range, ...]:
        """Fronts below the root, one range for each independent part of the tree, children before parents."""
        children = sorted(self.fronts[-1].children)
        starts = [0, *(child + 1 for child in children)]
        return tuple(range(start, child + 1) for start, child in zip(starts, children, strict=False))

    @property
    def n_operations(self) -> float:
        """Floating-point operations of one factorisation."""
        total = 0.0
        for front in self.fronts:
            n, k = front.stop - front.start, len(front.border)
            total += n**3 / 3 + n * n * k + n * k * k
        return total


def order_elimination(cells: CellGrid, leaf_size: int = LEAF_SIZE) -> Elimination:
    """Nested dissection by planes of the nodes of a grid of cells."""
    groups: list[np.ndarray] = []
    children: list[tuple[int, ...]] = []
    _dissect(np.arange(cells.n_nodes), cells.nodes, leaf_size, groups, children)
    groups[-1] = np.concatenate([groups[-1], cells.n_nodes + np.arange(3)])
    unknown = np.concatenate(groups)
    position = np.empty(len(unknown), dtype=np.int64)
    position[unknown] = np.arange(len(unknown))
    return Elimination(cells, position, unknown, _fronts(cells, position, unknown, groups, children))


def _dissect(
    ids: np.ndarray, nodes: np.ndarray, leaf_size: int, groups: list[np.ndarray], children: list[tuple[int, ...]]
) -> int:
    """Divide nodes by planes; appends the parts in the order of elimination and returns the last one's number."""
    cut = _best_plane(nodes[ids]) if len(ids) > leaf_size else None
    if cut is None:
        groups.append(ids)
        children.append(())
    else:
        axis, low = cut
        along = nodes[ids, axis]
        before, after = along < low, along >= low + STENCIL_REACH
        left = _dissect(ids[before], nodes, leaf_size, groups, children)
        right = _dissect(ids[after], nodes, leaf_size, groups, children)
        groups.append(ids[~(before | after)])
        children.append((left, right))
    return len(groups) - 1


def _best_plane(nodes: np.ndarray) -> tuple[int, int] | None:
    """Axis and first layer of the thinnest separator that divides the nodes fairly; None if there is none."""
    n, best = len(nodes), (LARGEST_SEPARATOR * len(nodes), None)
    for axis in range(3):
        layer = nodes[:, axis] - nodes[:, axis].min()
        before = np.concatenate([[0], np.cumsum(np.bincount(layer))])
        low = np.arange(1, len(before) - 1 - STENCIL_REACH)
        if len(low) == 0:
            continue
        left, separator = before[low], before[low + STENCIL_REACH] - before[low]
        right = n - left - separator
        cost = np.where(
            np.minimum(left, right) > SMALLEST_SIDE * n, separator * (1 + 0.6 * np.abs(left - right) / n), np.inf
        )
        k = int(np.argmin(cost))
        if cost[k] < best[0]:
            best = (float(cost[k]), (axis, int(low[k] + nodes[:, axis].min())))  # type: ignore[assignment]
    return best[1]


def _fronts(
    cells: CellGrid,
    position: np.ndarray,
    unknown: np.ndarray,
    groups: list[np.ndarray],
    children: list[tuple[int, ...]],
) -> list[Front]:
    """List the nodes that every part touches: of its cells and its children's borders, as far as eliminated later."""
    starts = np.concatenate([[0], np.cumsum([len(g) for g in groups])])
    cell_positions = position[cells.cell_nodes]
    first = cell_positions.min(axis=1)
    by_first = np.argsort(first, kind="stable")
    cuts = np.searchsorted(first[by_first], starts)
    fronts: list[Front] = []
    for k, group in enumerate(groups):
        start, stop = int(starts[k]), int(starts[k] + len(group))
        is_touched = np.zeros(len(position), dtype=np.bool_)
        is_touched[-3:] = True  # the constant
        for touched in (cell_positions[by_first[cuts[k] : cuts[k + 1]]], *(fronts[c].border for c in children[k])):
            is_touched[touched] = True
        border = stop + np.flatnonzero(is_touched[stop:])
        rows = tuple(_rows_of(fronts[c].border, start, stop, border) for c in children[k])
        unknowns = np.concatenate([unknown[start:stop], unknown[border]])
        fronts.append(Front(start, stop, border, children[k], rows, unknowns))
    return fronts


def _rows_of(positions: np.ndarray, start: int, stop: int, border: np.ndarray) -> np.ndarray:
    """Rows of a front at which positions lie."""
    later = (stop - start) + np.searchsorted(border, positions)
    return np.where(positions < stop, positions - start, later).astype(np.int64)
