# SPDX-License-Identifier: BSD-3-Clause
"""Compiled loops over samples and points of the spline model: Gram, evaluation, covariance."""

import numpy as np

from magmatch.compiled import allocating, compiled, compiled_ahead
from magmatch.field.cholesky.cells import CellGrid
from magmatch.field.spline.spline_basis import FIRST, derivative_rows, spline_values
from magmatch.typing import Matrix, Points


@compiled
def add_gram(  # type: ignore[no-untyped-def]
    order, cell, t, field, weight, cell_nodes, first_derivatives, half_offset, stencil, border, eta,
    vx, vy, vz, rows, gram, edge, rhs,
):  # fmt: skip
    """Add samples, visited cell by cell, to the Gram stencil, its border and the right-hand side."""
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
                # From the diagonal on, and a little before it: what is aligned is added faster.
                for b in range(8 * (a // 8), 64):
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
        for a in range(64):
            rhs[a] = 0.0
            for d in range(3):
                edge[a, d] = 0.0
            for b in range(64):
                gram[a, b] = 0.0


@allocating
def add_right_hand_sides(cell, t, fields, cell_nodes, first_derivatives, out):  # type: ignore[no-untyped-def]
    """Add ``Phi^T b`` of samples for several sets of field vectors, (n, 3, k), to the splines' rows of out."""
    vx, vy, vz, rows = np.zeros((4, 4)), np.zeros((4, 4)), np.zeros((4, 4)), np.zeros((3, 64))
    for i in range(len(cell)):
        if cell[i] < 0:
            continue
        spline_values(t[i, 0], vx)
        spline_values(t[i, 1], vy)
        spline_values(t[i, 2], vz)
        derivative_rows(vx, vy, vz, first_derivatives, 1.0, rows)
        for a in range(64):
            p = cell_nodes[cell[i], a]
            for d in range(3):
                for k in range(fields.shape[2]):
                    out[p, k] += rows[d, a] * fields[i, d, k]


def right_hand_sides(cells: CellGrid, points: Points, fields: np.ndarray) -> Matrix:
    """Sums ``Phi^T b`` of several sets of field vectors at points, (n, 3, k): (m + 3, k), the constant last."""
    cell, t = cells.locate(points)
    out = np.zeros((cells.n_nodes + 3, fields.shape[2]))
    add_right_hand_sides(cell, t, np.ascontiguousarray(fields), cells.cell_nodes, FIRST, out[:-3])
    out[-3:] = fields.sum(axis=0)
    return out


@compiled_ahead(
    "i8[::1], f8[:,::1], i4[:,::1], f8[::1], i8[:,::1], f8, f8[:,::1]",
    "f8[:,::1], f8[:,::1], f8[:,::1], f8[:,:,::1], f8[:,:,::1]",
)
def evaluate_points(cell, t, cell_nodes, weights, derivatives, spacing, out, vx, vy, vz, over_z, over_y):  # type: ignore[no-untyped-def]
    """Minus the listed derivatives of the potential at points; 0 where a point lies in no active cell."""
    last = len(derivatives) - 1
    highest = derivatives[last, 0] + derivatives[last, 1] + derivatives[last, 2]
    for i in range(len(cell)):
        if cell[i] < 0:
            continue
        spline_values(t[i, 0], vx)
        spline_values(t[i, 1], vy)
        spline_values(t[i, 2], vz)
        for a in range(4):
            for b in range(4):
                here, k = cell[i], 16 * a + 4 * b
                w0, w1 = weights[cell_nodes[here, k]], weights[cell_nodes[here, k + 1]]
                w2, w3 = weights[cell_nodes[here, k + 2]], weights[cell_nodes[here, k + 3]]
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
            unit = 1.0
            for _ in range(dx + dy + dz - 1):
                unit *= spacing
            out[i, r] = -total / unit


@compiled_ahead("f8[:,::1], i8[:,::1], f8, f8[:,:,::1], f8[:,::1], f8[:,::1], f8[:,::1]")
def linear_rows(t, derivatives, spacing, rows, vx, vy, vz):  # type: ignore[no-untyped-def]
    """Rows of the linear model at points in cells: (n, r, 67), the constant of the field's components last."""
    for i in range(len(t)):
        spline_values(t[i, 0], vx)
        spline_values(t[i, 1], vy)
        spline_values(t[i, 2], vz)
        derivative_rows(vx, vy, vz, derivatives, spacing, rows[i])
        for c in range(3):
            rows[i, c, 64 + c] = 1.0


@allocating
def point_covariances(order, cell, t, cell_nodes, derivatives, spacing, half_offset, stencil, border, corner, out):  # type: ignore[no-untyped-def]
    """Covariance of the listed derivatives (the first three with the constant added), points sorted by cell."""
    n_rows = derivatives.shape[0]
    vx, vy, vz = np.zeros((4, 4)), np.zeros((4, 4)), np.zeros((4, 4))
    block, first = np.zeros((67, 67)), 0
    block[64:, 64:] = corner
    while first < len(order):
        here, last = cell[order[first]], first + 1
        while last < len(order) and cell[order[last]] == here:
            last += 1
        if here >= 0:
            for a in range(64):
                p = cell_nodes[here, a]
                for b in range(a, 64):
                    block[a, b] = stencil[p, half_offset[a, b]]
                    block[b, a] = block[a, b]
                for c in range(3):
                    block[a, 64 + c] = border[p, c]
                    block[64 + c, a] = border[p, c]
            points = order[first:last]
            rows = np.zeros((last - first, n_rows, 67))
            linear_rows(t[points], derivatives, spacing, rows, vx, vy, vz)
            half = np.dot(rows.reshape(-1, 67), block).reshape(last - first, n_rows, 67)
            for k in range(last - first):
                for r in range(n_rows):
                    for s in range(r + 1):
                        total = 0.0
                        for a in range(67):
                            total += half[k, r, a] * rows[k, s, a]
                        out[points[k], r, s] = total
                        out[points[k], s, r] = total
        first = last
