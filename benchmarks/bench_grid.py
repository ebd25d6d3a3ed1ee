# SPDX-License-Identifier: BSD-3-Clause
"""Grid evaluation by separability against the dense sum over nodes, and exact covariances at points; one thread.

Usage: OPENBLAS_NUM_THREADS=1 python benchmarks/bench_grid.py [--spacing 0.05]
A node-point pair is a grid point and a node in whose support it lies: 64 for splines, all nodes for Gaussians. Points
outside the active cells count no pair. The dense sum multiplies the full matrix of basis functions (a GEMM where the
basis is dense) at a random subset of the grid's points; both must agree to 1e-9.
"""

import numpy as np
from bench_field import room
from numba import njit
from threadpoolctl import threadpool_limits

from magmatch.field.cholesky.selected_inverse import selected_inverse
from magmatch.field.hyperparameters import Hyperparameters
from magmatch.field.priors import PRIORS
from magmatch.field.spline.spline_basis import derivative_rows, derivative_table, spline_values
from magmatch_evaluation.script import arguments, timed

SIZE = (3.0, 3.0, 1.0)
H = {
    "spline": Hyperparameters(0.6, 1e-5, 3e-7, 0.2, 300.0),
    "divergence_free": Hyperparameters(0.6, 1e-5, 3e-7, 0.42),
    "curl_free": Hyperparameters(0.6, 1e-5, 3e-7, 0.42),
}


def best_of(task, n=5):
    """Shortest time of some runs, s, and the last answer."""
    task()
    runs = [timed(task) for _ in range(n)]
    return min(run.clock for run in runs), runs[-1].value


@njit(cache=True, fastmath=True)
def sum_over_nodes(cell, t, cell_nodes, weights, derivatives, spacing, out):
    """Peer: every derivative as a sum over the 64 nodes of each point, compiled as well."""
    vx, vy, vz = np.zeros((4, 4)), np.zeros((4, 4)), np.zeros((4, 4))
    rows = np.zeros((len(derivatives), 64))
    for i in range(len(cell)):
        if cell[i] < 0:
            continue
        spline_values(t[i, 0], vx)
        spline_values(t[i, 1], vy)
        spline_values(t[i, 2], vz)
        derivative_rows(vx, vy, vz, derivatives, spacing, rows)
        for r in range(len(derivatives)):
            for k in range(64):
                out[i, r] += rows[r, k] * weights[cell_nodes[cell[i], k]]


def dense_sum(posterior, points, order):
    """Field and derivatives without separability, in the order of `distinct`."""
    if not hasattr(posterior, "cells"):
        design = posterior.model.basis.design(points, order)
        return (design @ posterior.weights[:-3]).reshape(-1, len(points)).T
    cells, derivatives = posterior.cells, derivative_table(order)
    out = np.zeros((len(points), len(derivatives)))
    cell, t = cells.locate(points)
    sum_over_nodes(cell, t, cells.cell_nodes, posterior.weights, derivatives, cells.spacing, out)
    return out


def distinct(posterior, values, order):
    """The same numbers from field values."""
    n = len(values.field)
    parts = [values.field - posterior.weights[-3:]]
    full = [a.reshape(n, -1) for a in (values.gradient, values.second)[:order]]
    if hasattr(posterior, "cells"):
        columns = ([0, 1, 2, 4, 5, 8], [0, 1, 2, 4, 5, 8, 13, 14, 17, 26])
        full = [a[:, c] for a, c in zip(full, columns, strict=False)]
    return np.concatenate([*parts, *full], axis=1)


def measure_grid(name, posterior, axes, rng):
    """Print node-point pairs a second of the separable evaluation and of the dense sum."""
    points = np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1).reshape(-1, 3)
    is_spline = hasattr(posterior, "cells")
    n_nodes = 64 if is_spline else len(posterior.model.basis.grid)
    n_points = int(posterior.knows(points).sum()) if is_spline else len(points)
    some = rng.choice(len(points), 20000 if is_spline else 2000, replace=False)
    n_dense = int(posterior.knows(points[some]).sum()) if is_spline else len(some)
    print(f"{name}: {len(points):,} points, {n_nodes} nodes in support")
    for order in range(3):
        seconds, values = best_of(lambda order=order: posterior.evaluate_on_grid(axes, order))
        dense_seconds, dense = best_of(lambda order=order: dense_sum(posterior, points[some], order), 2)
        grid = distinct(posterior, values, order)[some]
        scale = np.abs(dense).max(axis=0)
        difference = np.max(np.abs(grid - dense) / scale)
        rate, dense_rate = n_points * n_nodes / seconds / 1e6, n_dense * n_nodes / dense_seconds / 1e6
        print(
            f"    order {order}: {seconds * 1e3:7.1f} ms, {rate:7.0f} million pairs/s; dense sum {dense_rate:6.1f}; "
            f"{rate / dense_rate:5.1f} times; largest relative difference {difference:.1e}"
        )
        assert difference < 1e-9


def measure_points(posterior, q):
    """Print times of what the map says at scattered points."""
    print(f"spline at {len(q):,} scattered points of a {len(posterior.weights):,}-weight model")
    for order in range(3):
        seconds, _ = best_of(lambda order=order: posterior.evaluate(q, order))
        print(f"    mean to order {order}: {seconds * 1e3:.2f} ms")
    seconds, _ = best_of(lambda: selected_inverse(posterior.factor))
    print(f"    selected inverse, once a map: {seconds * 1e3:.0f} ms")
    posterior.covariance(q, 1)
    for order in range(2):
        seconds, _ = best_of(lambda order=order: posterior.covariance(q, order))
        print(f"    exact covariance of order {order}, then: {seconds * 1e3:.1f} ms")
    seconds, _ = best_of(lambda: posterior.joint_covariance(q[:300]))
    print(f"    joint covariance of 300 points: {seconds * 1e3:.0f} ms")


def main():
    spacing = arguments(__doc__, spacing=0.05).spacing
    x, b, tests = room(4, 3000, size=SIZE)
    axes = tuple(np.arange(-0.2, length + 0.2, spacing) for length in SIZE)
    rng = np.random.default_rng(0)
    for name, h in H.items():
        model = PRIORS[name].build(x, b, h)
        posterior = model.infer(model.observe(x, b))
        measure_grid(name, posterior, axes, rng)
        if name == "spline":
            measure_points(posterior, tests["between"][0])


if __name__ == "__main__":
    with threadpool_limits(1):
        main()
