# SPDX-License-Identifier: BSD-3-Clause
"""Measurements in one block of cells: a few samples per cell as they are, the rest as sums.

The sums are the information of a cell's samples on its 64 splines and the constant field. They are exact, and a cell
that was visited for hours takes no more memory than one visited for a minute.
"""

from dataclasses import dataclass

import numpy as np

from magmatch.compiled import allocating, compiled
from magmatch.field.cholesky.cells import HALF_OFFSET, CellGrid
from magmatch.field.spline.spline_basis import FIRST, derivative_rows, spline_values
from magmatch.field.spline.spline_model import SplineInformation
from magmatch.typing import Points

# Samples that a cell keeps as they are, 48 bytes each, before it starts to add up.
KEPT_PER_CELL = 64
# Where a cell's sums stand: Gram matrix (upper triangle), its border, right-hand side, sum of the fields, of their
# squares, and number of samples. 18.7 kB in all.
BORDER, RHS, TOTAL, SQUARE, COUNT = 2080, 2272, 2336, 2339, 2340
N_SUMS = 2341


@dataclass(frozen=True, eq=False, slots=True)
class MeasuredCells:
    """All that was measured in some cells, as a checkpoint keeps it."""

    kept: np.ndarray  # (n, 6): position (m) and field (T) of samples that are kept as they are, block by block
    cells: np.ndarray  # (k, 3) int: cells of the lattice that hold more
    sums: np.ndarray  # (k, N_SUMS): sums over their other samples
    total: np.ndarray  # (3,), T: sum of all fields, and of their products, (3, 3), T^2
    squares: np.ndarray

    def __post_init__(self) -> None:
        n, k = len(self.kept), len(self.sums)
        shapes = {"kept": (n, 6), "cells": (k, 3), "sums": (k, N_SUMS), "total": (3,), "squares": (3, 3)}
        for name, shape in shapes.items():
            array, kind = getattr(self, name), np.int64 if name == "cells" else np.float64
            if array.shape != shape or array.dtype != kind or not np.isfinite(array).all():
                msg = f"entry '{name}': expected finite numbers of shape {shape}, got {array.dtype} of {array.shape}"
                raise ValueError(msg)
        if (self.sums[:, COUNT] < 1).any() or (self.sums[:, COUNT] % 1).any():
            msg = "entry 'sums': expected a count of samples in each row"
            raise ValueError(msg)


class Block:
    """Samples of a cube of cells."""

    def __init__(self, first: np.ndarray, side: int) -> None:
        self.first, self.side = first, side
        self.version = 0
        self.seen = np.zeros(side**3, dtype=np.int64)
        self.slot = np.full(side**3, -1, dtype=np.int32)
        self._kept, self._n_kept = np.empty((KEPT_PER_CELL, 6)), 0
        self._sums, self._n_sums = np.zeros((0, N_SUMS)), 0

    @property
    def kept(self) -> np.ndarray:
        """Position (m) and field (T) of the samples that are kept as they are, in order of arrival: (n, 6)."""
        return self._kept[: self._n_kept]

    @property
    def sums(self) -> np.ndarray:
        """Sums over the other samples, one row per cell: (k, N_SUMS)."""
        return self._sums[: self._n_sums]

    @property
    def summed_cells(self) -> np.ndarray:
        """Cells of the lattice that the rows of `sums` belong to: (k, 3)."""
        number = np.flatnonzero(self.slot >= 0)
        number = number[np.argsort(self.slot[number])]
        return np.asarray(self.first + np.stack(np.unravel_index(number, (self.side,) * 3), axis=1))

    @property
    def n_bytes(self) -> int:
        """Memory in use."""
        return int(self.seen.nbytes + self.slot.nbytes + self._kept.nbytes + self._sums.nbytes)

    def absorb(self, cell: np.ndarray, t: Points, samples: np.ndarray) -> np.ndarray:
        """Take in samples of this block, one after the other."""
        number = np.ravel_multi_index(tuple((cell - self.first).T), (self.side,) * 3)
        is_new = self.seen[number] == 0
        self._reserve(number)
        self._n_kept, self._n_sums = _absorb(
            number, t, samples, FIRST, self.seen, self.slot, self._kept, self._n_kept, self._sums, self._n_sums
        )
        self.version += 1
        return np.asarray(is_new)

    def restore(self, cells: np.ndarray, sums: np.ndarray) -> None:
        """Put back sums that were saved, after the kept samples were absorbed again."""
        if self._n_sums:
            msg = f"entry 'kept': expected at most {KEPT_PER_CELL} samples of a cell"
            raise ValueError(msg)
        number = np.ravel_multi_index(tuple((cells - self.first).T), (self.side,) * 3)
        self.slot[number] = np.arange(len(number))
        self.seen[number] += sums[:, COUNT].astype(np.int64)
        self._sums, self._n_sums = sums.copy(), len(sums)
        self.version += 1

    def _reserve(self, number: np.ndarray) -> None:
        """Make room for what these samples may need; doubling, so that a sample costs no more than a few copies."""
        self._kept = _grown(self._kept, self._n_kept + len(number))
        full = np.unique(number)
        count = np.bincount(number, minlength=len(self.seen))[full]
        overflow = (self.seen[full] + count > KEPT_PER_CELL) & (self.slot[full] < 0)
        self._sums = _grown(self._sums, self._n_sums + int(overflow.sum()))


def add_sums(information: SplineInformation, cells: CellGrid, block: Block) -> SplineInformation:
    """Information in samples of which only the sums are left, besides other information."""
    shape = np.array(cells.cell_index.shape)
    local = block.summed_cells - cells.first
    rows = np.flatnonzero(np.all((local >= 0) & (local < shape), axis=1))
    number = cells.cell_index[tuple(local[rows].T)]
    rows, number = rows[number >= 0], number[number >= 0]
    gram, m = information.gram, cells.n_nodes
    _add_sums(rows, number, block.sums, cells.cell_nodes, HALF_OFFSET, gram.stencil, gram.border, information.eta[:m])
    counted = block.sums[rows, COUNT].sum()
    gram.corner[range(3), range(3)] += counted
    information.eta[m:] += block.sums[rows, TOTAL:SQUARE].sum(axis=0)
    square = float(block.sums[rows, SQUARE].sum())
    return SplineInformation(
        gram, information.eta, information.square + square, information.n_values + 3.0 * float(counted)
    )


def _grown(array: np.ndarray, n_rows: int) -> np.ndarray:
    """Copy the rows into an array that holds at least so many."""
    if n_rows <= len(array):
        return array
    grown = np.zeros((max(n_rows, 2 * len(array)), array.shape[1]))
    grown[: len(array)] = array
    return grown


@allocating
def _absorb(number, t, samples, first, seen, slot, kept, n_kept, sums, n_sums):  # type: ignore[no-untyped-def]
    vx, vy, vz, rows = np.zeros((4, 4)), np.zeros((4, 4)), np.zeros((4, 4)), np.zeros((3, 64))
    for i in range(len(number)):
        cell = number[i]
        seen[cell] += 1
        if seen[cell] <= KEPT_PER_CELL:
            kept[n_kept] = samples[i]
            n_kept += 1
            continue
        if slot[cell] < 0:
            slot[cell] = n_sums
            n_sums += 1
        out = sums[slot[cell]]
        spline_values(t[i, 0], vx)
        spline_values(t[i, 1], vy)
        spline_values(t[i, 2], vz)
        derivative_rows(vx, vy, vz, first, 1.0, rows)
        row_start = 0
        for a in range(64):
            for d in range(3):
                out[BORDER + 3 * a + d] += rows[d, a]
                out[RHS + a] += rows[d, a] * samples[i, 3 + d]
            for b in range(a, 64):
                product = rows[0, a] * rows[0, b] + rows[1, a] * rows[1, b] + rows[2, a] * rows[2, b]
                out[row_start + b - a] += product
            row_start += 64 - a
        for d in range(3):
            out[TOTAL + d] += samples[i, 3 + d]
            out[SQUARE] += samples[i, 3 + d] ** 2
        out[COUNT] += 1.0
    return n_kept, n_sums


@compiled
def _add_sums(rows, number, sums, cell_nodes, half_offset, stencil, border, eta):  # type: ignore[no-untyped-def]
    for k in range(len(rows)):
        one, row_start = sums[rows[k]], 0
        for a in range(64):
            p = cell_nodes[number[k], a]
            eta[p] += one[RHS + a]
            for d in range(3):
                border[p, d] += one[BORDER + 3 * a + d]
            for b in range(a, 64):
                stencil[p, half_offset[a, b]] += one[row_start + b - a]
            row_start += 64 - a
