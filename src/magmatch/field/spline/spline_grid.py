# SPDX-License-Identifier: BSD-3-Clause
"""The spline model on regular grids: coefficients contracted along x, then y, then z.

Every derivative of a tensor product is one table per axis, so a point costs four products per derivative instead of
64: a slab of coefficients is contracted once per x of the grid, a plane once per (x, y), and only the last sum runs
over points. Memory besides the answer: one slab, four nodes thick.
"""

import numpy as np

from magmatch.compiled import compiled, inlined
from magmatch.field.cholesky.cells import STENCIL_REACH, CellGrid
from magmatch.field.linear_model import Axes
from magmatch.field.spline.spline_basis import (
    FIRST,
    GRADIENT_INDEX,
    SECOND,
    SECOND_INDEX,
    THIRD,
    derivative_table,
    spline_values,
)
from magmatch.field.values import FieldValues
from magmatch.typing import Scalars

# Derivatives in the plane, (dx, dy), fewest first: with dz along z only those of order up to 3 - dz are needed.
_IN_PLANE = np.array([(0, 0), (1, 0), (0, 1), (2, 0), (1, 1), (0, 2), (3, 0), (2, 1), (1, 2), (0, 3)])
# Numbers per sum over a line, padded to what one instruction holds.
_WIDTH = 12


def evaluate_on_grid(cells: CellGrid, axes: Axes, weights: Scalars, order: int) -> FieldValues:
    """Field and derivatives of a spline potential on the grid spanned by three axes."""
    highest = int(derivative_table(order)[-1].sum())
    located = [cells.axis_cells(np.asarray(x, dtype=np.float64), axis) for axis, x in enumerate(axes)]
    ix, iy, iz = (i for i, _ in located)
    vx, vy, vz = (_axis_table(t, cells.spacing) for _, t in located)
    n = len(ix) * len(iy) * len(iz)
    field = np.tile(weights[-3:], (n, 1))
    gradient, second = np.zeros((n if order >= 1 else 0, 9)), np.zeros((n if order >= 2 else 0, 27))
    n_in_plane = np.array([(highest - dz + 1) * (highest - dz + 2) // 2 for dz in range(highest + 1)])
    # The sign and unit of B = -grad phi, phi in spacings.
    _contract(
        ix, iy, iz, vx, vy, vz, cells.cell_index, cells.node_index, -cells.spacing * weights[:-3], n_in_plane,
        _places(FIRST), _places(SECOND)[GRADIENT_INDEX.ravel()], _places(THIRD)[SECOND_INDEX.ravel()],
        field, gradient, second,
    )  # fmt: skip
    return FieldValues(
        field,
        gradient.reshape(n, 3, 3) if order >= 1 else None,
        second.reshape(n, 3, 3, 3) if order >= 2 else None,
    )


def _places(derivatives: np.ndarray) -> np.ndarray:
    """Say where the sums of a point hold each derivative of the potential."""
    in_plane = [int(np.flatnonzero((d[:2] == _IN_PLANE).all(axis=1))[0]) for d in derivatives]
    return np.asarray(derivatives[:, 2] * _WIDTH + in_plane, dtype=np.uint64)


@compiled
def _axis_table(t: np.ndarray, spacing: float) -> np.ndarray:
    """Splines and their derivatives along one axis, per metre: (n, 4, 4)."""
    tables = np.zeros((len(t), 4, 4))
    for i in range(len(t)):
        spline_values(t[i], tables[i])
        unit = 1.0
        for d in range(1, 4):
            unit *= spacing
            for k in range(4):
                tables[i, d, k] /= unit
    return tables


@compiled
def _contract(  # type: ignore[no-untyped-def]  # noqa: PLR0912
    ix, iy, iz, vx, vy, vz, cell_index, node_index, weights, n_in_plane, first, second_index, third, field, gradient,
    second,
):  # fmt: skip
    n_x, n_y, n_z = cell_index.shape
    y_low, y_high = _span(iy, n_y)
    z_low, z_high = _span(iz, n_z)
    highest = len(n_in_plane) - 1
    slab = np.zeros((4, y_high - y_low, z_high - z_low))
    plane = np.zeros((highest + 1, y_high - y_low, z_high - z_low))
    line = np.zeros((z_high - z_low, _WIDTH))
    sums = np.zeros(4 * _WIDTH)
    last = -1
    for i in range(len(ix)):
        if ix[i] < 0 or ix[i] >= n_x or z_high == z_low:
            continue
        if ix[i] != last:
            last = ix[i]
            _load_slab(last, y_low, z_low, node_index, weights, slab)
        for d in range(highest + 1):
            v0, v1, v2, v3 = vx[i, d, 0], vx[i, d, 1], vx[i, d, 2], vx[i, d, 3]
            for y in range(plane.shape[1]):
                for z in range(plane.shape[2]):
                    plane[d, y, z] = v0 * slab[0, y, z] + v1 * slab[1, y, z] + v2 * slab[2, y, z] + v3 * slab[3, y, z]
        for j in range(len(iy)):
            if iy[j] < 0 or iy[j] >= n_y:
                continue
            column, is_filled = cell_index[ix[i], iy[j]], False
            for k in range(len(iz)):
                if iz[k] < 0 or iz[k] >= n_z or column[iz[k]] < 0:
                    continue
                if not is_filled:
                    _fill_line(iy[j] - y_low, vy[j], highest, plane, line)
                    is_filled = True
                _sum_line(iz[k] - z_low, vz[k], n_in_plane, line, sums)
                row = (i * len(iy) + j) * len(iz) + k
                for q in range(3):
                    field[row, q] += sums[first[q]]
                if highest >= 2:
                    for q in range(9):
                        gradient[row, q] = sums[second_index[q]]
                if highest >= 3:
                    for q in range(27):
                        second[row, q] = sums[third[q]]


@compiled
def _span(index, n):  # type: ignore[no-untyped-def]
    """First node and one past the last that cells of an axis touch, as far as they exist."""
    low, high = n, 0
    for i in index:
        if 0 <= i < n:
            low, high = min(low, i), max(high, i + 4)
    return min(low, high), high


@compiled
def _load_slab(x, y_low, z_low, node_index, weights, slab):  # type: ignore[no-untyped-def]
    """Coefficients of the four layers of nodes that a layer of cells touches; 0 where there is no node."""
    for a in range(4):
        for y in range(slab.shape[1]):
            for z in range(slab.shape[2]):
                node = node_index[x + a + STENCIL_REACH, y + y_low + STENCIL_REACH, z + z_low + STENCIL_REACH]
                slab[a, y, z] = weights[node] if node >= 0 else 0.0


@inlined
def _fill_line(y, v, highest, plane, line):  # type: ignore[no-untyped-def]
    """All derivatives in the plane along one line of nodes."""
    for p in range((highest + 1) * (highest + 2) // 2):
        dx, dy = _IN_PLANE[p, 0], _IN_PLANE[p, 1]
        for z in range(line.shape[0]):
            line[z, p] = (
                v[dy, 0] * plane[dx, y, z]
                + v[dy, 1] * plane[dx, y + 1, z]
                + v[dy, 2] * plane[dx, y + 2, z]
                + v[dy, 3] * plane[dx, y + 3, z]
            )


@inlined
def _sum_line(z, v, n_in_plane, line, sums):  # type: ignore[no-untyped-def]
    """All derivatives at one point of a line: more than are asked for, since known counts become vector code."""
    # Unsigned, or every access would first ask whether to count from the end.
    z0, z1, z2, z3 = np.uint64(z), np.uint64(z + 1), np.uint64(z + 2), np.uint64(z + 3)
    for dz in range(len(n_in_plane)):
        v0, v1, v2, v3 = v[dz, 0], v[dz, 1], v[dz, 2], v[dz, 3]
        at = np.uint64(dz * _WIDTH)
        if n_in_plane[dz] > 6:
            for k in range(_WIDTH):
                p = np.uint64(k)
                sums[at + p] = v0 * line[z0, p] + v1 * line[z1, p] + v2 * line[z2, p] + v3 * line[z3, p]
        else:
            for k in range(8):
                p = np.uint64(k)
                sums[at + p] = v0 * line[z0, p] + v1 * line[z1, p] + v2 * line[z2, p] + v3 * line[z3, p]
