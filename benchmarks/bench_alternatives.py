# SPDX-License-Identifier: BSD-3-Clause
"""What our own k-d tree, CSV parser and sparse Cholesky factors do, against SciPy, pandas and SuperLU.

Run ``python benchmarks/bench_alternatives.py``; needs the extra ``test``. Seconds of the processor, best of three,
after compilation. docs/decisions.md says what follows.
"""

import os
import tempfile
from collections.abc import Callable
from pathlib import Path
from typing import Any

os.environ["OPENBLAS_NUM_THREADS"] = "1"

import numpy as np

from magmatch_evaluation.script import arguments, timed

# For SuperLU: a symmetric positive definite matrix.
SYMMETRIC: dict[str, Any] = {
    "permc_spec": "MMD_AT_PLUS_A", "diag_pivot_thresh": 0.0, "options": {"SymmetricMode": True},
}  # fmt: skip


def seconds(run: Callable[[], Any], repeats: int = 3) -> float:
    """Least processor time of some runs."""
    return min(timed(run).processor for _ in range(repeats))


def kdtree(n: int) -> None:
    from scipy.spatial import KDTree

    from magmatch.registration.search.kdtree import NeighbourTree

    rng = np.random.default_rng(0)
    points, targets = rng.normal(size=(n, 6)).astype(np.float32), rng.normal(size=(2000, 6)).astype(np.float32)
    for name, make in (("ours", NeighbourTree.of), ("SciPy", KDTree)):
        tree = make(points)
        tree.query(targets[:2], 8)
        print(f"k-d tree, {n} points of 6 numbers, {name}: build {seconds(lambda m=make: m(points)):.3f} s, "
              f"8 nearest of 2000 {seconds(lambda t=tree: t.query(targets, 8)):.3f} s")  # fmt: skip


def tables(n: int, folder: Path) -> None:
    import pandas as pd

    from magmatch.data.tables.table import Wanted, read_table

    names = ["t", "x", "y", "z", "bx", "by", "bz"]
    numbers = np.random.default_rng(0).normal(size=(n, 7))
    path = folder / "survey.csv"
    path.write_text("\n".join([",".join(names), *(",".join(map(repr, row)) for row in numbers.tolist()), ""]))
    ours, theirs = read_table(path, Wanted(names)), pd.read_csv(path)
    print(f"CSV, {path.stat().st_size / 1e6:.0f} MB: ours {seconds(lambda: read_table(path, Wanted(names))):.2f} s, "
          f"pandas {seconds(lambda: pd.read_csv(path)):.2f} s; "
          f"{sum(int((theirs[k] != ours.columns[k]).sum()) for k in names)} of {n * 7} numbers differ")  # fmt: skip


def cholesky(side: float) -> None:
    from scipy.sparse import coo_array
    from scipy.sparse.linalg import splu

    from magmatch.field.cholesky.cells import HALF_STENCIL, lay_cells
    from magmatch.field.cholesky.multifrontal import factorise
    from magmatch.field.cholesky.nested_dissection import order_elimination
    from magmatch.field.cholesky.selected_inverse import selected_inverse
    from magmatch.field.hyperparameters import Hyperparameters
    from magmatch.field.spline.spline_model import SplineModel

    rng = np.random.default_rng(0)
    x = rng.uniform(0, 1, (20_000, 3)) * [side, side, 0.4]
    h = Hyperparameters(0.4, 1e-5, 1e-6, 0.15, 100.0)
    cells = lay_cells(x, h.spacing, 1.5)
    model = SplineModel(h, order_elimination(cells))
    information = model.observe(x, 1e-5 * rng.normal(size=x.shape))
    A, m = information.gram + model.prior_precision(), cells.n_nodes
    other = cells.node_index.ravel()[cells.flat_nodes[:, None] + cells.shifts[HALF_STENCIL - 1 :]]
    row, slot = np.nonzero(other >= 0)
    column, values = other[row, slot], A.stencil[row, slot]
    off = row != column
    edge = np.repeat(np.arange(m), 3), np.tile(np.arange(m, m + 3), m)
    corner = np.repeat(np.arange(m, m + 3), 3), np.tile(np.arange(m, m + 3), 3)
    rows = np.concatenate([row, column[off], edge[0], edge[1], corner[0]])
    columns = np.concatenate([column, row[off], edge[1], edge[0], corner[1]])
    entries = np.concatenate([values, values[off], A.border.ravel(), A.border.ravel(), A.corner.ravel()])
    sparse = coo_array((entries, (rows, columns)), shape=(m + 3, m + 3)).tocsc()
    factor = factorise(model.elimination, A)
    selected_inverse(factor)
    theirs = splu(sparse, **SYMMETRIC)
    difference = np.abs(factor.solve(information.eta) - theirs.solve(information.eta)).max()
    scale = np.abs(factor.solve(information.eta)).max()
    ours, lu = seconds(lambda: factorise(model.elimination, A)), seconds(lambda: splu(sparse, **SYMMETRIC), 1)
    print(f"Cholesky, {m + 3} unknowns, {sparse.nnz} entries: ours {ours:.2f} s, {factor.n_bytes / 1e6:.0f} MB; "
          f"SuperLU {lu:.2f} s, {(theirs.L.nnz + theirs.U.nnz) * 12 / 1e6:.0f} MB; "
          f"solutions differ by {difference / scale:.1e}")  # fmt: skip
    column = np.zeros(m + 3)
    column[0] = 1.0
    print(f"  all variances: ours {seconds(lambda: selected_inverse(factor)):.2f} s (selected inverse); "
          f"SuperLU {m * seconds(lambda: theirs.solve(column)):.0f} s ({m} solves)")  # fmt: skip


def pose_graph(n: int) -> None:
    from scipy.sparse import csc_array, tril
    from scipy.sparse.linalg import splu

    from magmatch.slam.graph.block_cholesky import BlockCholesky, sum_of_blocks

    # A walk through streets, turning at random: each node is tied to the one before it and to the last at its place.
    rng = np.random.default_rng(0)
    turns = np.pi / 2 * np.cumsum(rng.choice([-1, 0, 0, 0, 0, 1], n))
    places = np.cumsum(np.column_stack([np.cos(turns), np.sin(turns)]), axis=0).round() % 16
    pairs, last = [(k, k + 1) for k in range(n - 1)], {}
    for k, place in enumerate(map(tuple, places.tolist())):
        pairs += [(last[place], k)] if place in last else []
        last[place] = k
    rows, columns, blocks = list(range(n)), list(range(n)), [1e-3 * np.eye(6)] * n
    for one, other in pairs:
        J = np.eye(6) + 0.2 * rng.normal(size=(2, 6, 6))
        rows += [one, other, other]
        columns += [one, one, other]
        blocks += [J[0].T @ J[0], J[1].T @ J[0], J[1].T @ J[1]]
    A = sum_of_blocks(np.array(rows), np.array(columns), np.array(blocks), n)
    whole = csc_array(tril(A) + tril(A, -1).T)
    factor, theirs, unit = BlockCholesky.of(A), splu(whole, **SYMMETRIC), np.eye(6 * n)[:, :6]
    factor.inverse()
    print(f"Pose graph, {n} nodes, {len(pairs)} ties: ours {seconds(lambda: BlockCholesky.of(A)):.3f} s, "
          f"SuperLU {seconds(lambda: splu(whole, **SYMMETRIC)):.3f} s; all covariances: ours "
          f"{seconds(factor.inverse):.3f} s (selected inverse), "
          f"SuperLU {n * seconds(lambda: theirs.solve(unit)):.0f} s ({n} solves)")  # fmt: skip


def main() -> None:
    asked = arguments(__doc__, points=100_000, rows=300_000, side=2.0, nodes=2000)
    with tempfile.TemporaryDirectory() as folder:
        kdtree(asked.points)
        tables(asked.rows, Path(folder))
        cholesky(asked.side)
        pose_graph(asked.nodes)


if __name__ == "__main__":
    main()
