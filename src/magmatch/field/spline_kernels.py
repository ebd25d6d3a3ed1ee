# SPDX-License-Identifier: BSD-3-Clause
"""Compiled loops over samples and points of the spline model: Gram, evaluation, covariance."""

import numpy as np
from numba import njit

from magmatch.field.spline_basis import derivative_rows, spline_values


@njit(cache=True, fastmath=True)
def add_gram(order, cell, t, field, weight, cell_nodes, first_derivatives, half_offset, stencil, border, eta):  # type: ignore[no-untyped-def]
    """Add samples, visited cell by cell, to the Gram stencil, its border and the right-hand side."""
    vx, vy, vz, rows = np.zeros((4, 4)), np.zeros((4, 4)), np.zeros((4, 4)), np.zeros((3, 64))
    gram, edge, rhs = np.zeros((64, 64)), np.zeros((64, 3)), np.zeros(64)
    for k in range(len(order)):
        i = order[k]
        spline_values(t[i, 0], vx)
        spline_values(t[i, 1], vy)
        spline_values(t[i, 2], vz)
        derivative_rows(vx, vy, vz, first_derivatives, 1.0, rows)
        for d in range(3):
            for a in range(64):
                scaled = weight[i] * rows[d, a]
                rhs[a] += scaled * field[i, d]
                edge[a, d] += scaled
                for b in range(64):
                    gram[a, b] += scaled * rows[d, b]
        if k + 1 < len(order) and cell[order[k + 1]] == cell[i]:
            continue
        for a in range(64):
            p = cell_nodes[cell[i], a]
            eta[p] += rhs[a]
            for d in range(3):
                border[p, d] += edge[a, d]
            for b in range(a, 64):
                stencil[p, half_offset[a, b]] += gram[a, b]
        gram[:], edge[:], rhs[:] = 0.0, 0.0, 0.0


@njit(cache=True, fastmath=True)
def evaluate_points(cell, t, cell_nodes, weights, derivatives, spacing, out):  # type: ignore[no-untyped-def]
    """Minus the listed derivatives of the potential at points; 0 where a point lies in no active cell."""
    vx, vy, vz = np.zeros((4, 4)), np.zeros((4, 4)), np.zeros((4, 4))
    highest = derivatives[-1].sum()
    over_z, over_y = np.zeros((4, 4, 4)), np.zeros((4, 4, 4))
    for i in range(len(cell)):
        if cell[i] < 0:
            continue
        spline_values(t[i, 0], vx)
        spline_values(t[i, 1], vy)
        spline_values(t[i, 2], vz)
        nodes = cell_nodes[cell[i]]
        for a in range(4):
            for b in range(4):
                k = 16 * a + 4 * b
                w0, w1, w2, w3 = (
                    weights[nodes[k]],
                    weights[nodes[k + 1]],
                    weights[nodes[k + 2]],
                    weights[nodes[k + 3]],
                )
                for d in range(highest + 1):
                    over_z[d, a, b] = w0 * vz[d, 0] + w1 * vz[d, 1] + w2 * vz[d, 2] + w3 * vz[d, 3]
            for dz in range(highest + 1):
                for dy in range(highest + 1 - dz):
                    total = 0.0
                    for b in range(4):
                        total += vy[dy, b] * over_z[dz, a, b]
                    over_y[dy, dz, a] = total
        for r in range(derivatives.shape[0]):
            dx, dy, dz = derivatives[r, 0], derivatives[r, 1], derivatives[r, 2]
            total = 0.0
            for a in range(4):
                total += vx[dx, a] * over_y[dy, dz, a]
            out[i, r] = -total / spacing ** (dx + dy + dz - 1)


@njit(cache=True, fastmath=True)
def evaluate_grid(ix, iy, iz, vx, vy, vz, cell_index, node_index, weights, derivatives, spacing, out):  # type: ignore[no-untyped-def]  # noqa: PLR0912
    """Minus the listed derivatives at the points spanned by three axes: sums along x, then y, then z."""
    highest = derivatives[-1].sum()
    n_y, n_z = cell_index.shape[1] + 3, cell_index.shape[2] + 3
    plane, line = np.zeros((highest + 1, n_y, n_z)), np.zeros((highest + 1, highest + 1, n_z))
    scale = np.ones(highest + 1)
    for d in range(2, highest + 1):
        scale[d] = scale[d - 1] / spacing
    for i in range(len(ix)):
        if ix[i] < 0 or ix[i] >= cell_index.shape[0]:
            continue
        plane[:] = 0.0
        for a in range(4):
            for y in range(n_y):
                for z in range(n_z):
                    node = node_index[ix[i] + a + 3, y + 3, z + 3]
                    if node >= 0:
                        for d in range(highest + 1):
                            plane[d, y, z] += vx[i, d, a] * weights[node]
        for j in range(len(iy)):
            if iy[j] < 0 or iy[j] >= cell_index.shape[1]:
                continue
            line[:] = 0.0
            for dx in range(highest + 1):
                for dy in range(highest + 1 - dx):
                    for b in range(4):
                        for z in range(n_z):
                            line[dx, dy, z] += vy[j, dy, b] * plane[dx, iy[j] + b, z]
            for k in range(len(iz)):
                if iz[k] < 0 or iz[k] >= cell_index.shape[2] or cell_index[ix[i], iy[j], iz[k]] < 0:
                    continue
                row = (i * len(iy) + j) * len(iz) + k
                for r in range(derivatives.shape[0]):
                    dx, dy, dz = derivatives[r, 0], derivatives[r, 1], derivatives[r, 2]
                    total = 0.0
                    for c in range(4):
                        total += vz[k, dz, c] * line[dx, dy, iz[k] + c]
                    out[row, r] = -scale[dx + dy + dz] * total


@njit(cache=True)
def axis_tables(t: np.ndarray) -> np.ndarray:
    """Spline values and derivatives at many positions in a cell: (n, 4, 4)."""
    tables = np.zeros((len(t), 4, 4))
    for i in range(len(t)):
        spline_values(t[i], tables[i])
    return tables


@njit(cache=True, fastmath=True)
def point_covariances(order, cell, t, cell_nodes, derivatives, spacing, half_offset, stencil, border, corner, out):  # type: ignore[no-untyped-def]  # noqa: PLR0912
    """Covariance of the listed derivatives (the first three with the constant added), points sorted by cell."""
    n_rows = derivatives.shape[0]
    vx, vy, vz, rows = np.zeros((4, 4)), np.zeros((4, 4)), np.zeros((4, 4)), np.zeros((n_rows, 64))
    full, block = np.zeros((n_rows, 67)), np.zeros((67, 67))
    product, last = np.zeros((n_rows, 67)), -1
    block[64:, 64:] = corner
    for k in range(len(order)):
        i = order[k]
        if cell[i] < 0:
            continue
        if cell[i] != last:
            last = cell[i]
            for a in range(64):
                p = cell_nodes[last, a]
                for b in range(a, 64):
                    value = stencil[p, half_offset[a, b]]
                    block[a, b] = value
                    block[b, a] = value
                for c in range(3):
                    block[a, 64 + c] = border[p, c]
                    block[64 + c, a] = border[p, c]
        spline_values(t[i, 0], vx)
        spline_values(t[i, 1], vy)
        spline_values(t[i, 2], vz)
        derivative_rows(vx, vy, vz, derivatives, spacing, rows)
        full[:, :64] = rows
        for c in range(3):
            full[c, 64 + c] = 1.0
        for r in range(n_rows):
            for a in range(67):
                total = 0.0
                for b in range(67):
                    total += block[a, b] * full[r, b]
                product[r, a] = total
        for r in range(n_rows):
            for s in range(r + 1):
                total = 0.0
                for a in range(67):
                    total += full[r, a] * product[s, a]
                out[i, r, s] = total
                out[i, s, r] = total
