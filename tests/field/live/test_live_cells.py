# SPDX-License-Identifier: BSD-3-Clause
"""A block of cells keeps all that its samples say, as they are or summed."""

import numpy as np
import pytest

from magmatch.field.cholesky.cells import lattice_coordinate
from magmatch.field.hyperparameters import Hyperparameters
from magmatch.field.live.live_cells import COUNT, KEPT_PER_CELL, Block, add_sums
from magmatch.field.spline.spline_model import SplineModel

H = Hyperparameters(0.5, 1e-5, 5e-7, 0.25, 1.0)


@pytest.mark.parametrize("n_parts", [1, 7])
def test_what_is_kept_and_what_is_summed_is_the_information_of_all_samples(n_parts):
    rng = np.random.default_rng(0)
    # Two cells that overflow and some that do not.
    x = np.concatenate(
        [rng.uniform(-0.3, 0.3, (250, 3)) * [1, 0.4, 0.4], [0.25, 0, 0] + 0.02 * rng.normal(size=(90, 3))]
    )
    x = x[rng.permutation(len(x))]
    b = 4e-5 * rng.normal(size=x.shape)
    coordinate = lattice_coordinate(x, H.spacing)
    cell = np.floor(coordinate).astype(np.int64)
    block, n_new = Block(np.full(3, -4), 8), 0
    for rows in np.array_split(np.arange(len(x)), n_parts):
        is_new = block.absorb(cell[rows], coordinate[rows] - cell[rows], np.hstack([x, b])[rows])
        n_new += len(np.unique(cell[rows][is_new], axis=0))
    assert n_new == len(np.unique(cell, axis=0))
    assert block.sums[:, COUNT].sum() + len(block.kept) == len(x)
    assert len(block.sums) == (np.unique(cell, axis=0, return_counts=True)[1] > KEPT_PER_CELL).sum() == 3
    assert block.n_bytes >= block.kept.nbytes + block.sums.nbytes + 8**3 * 12
    model = SplineModel.over(x, H)
    expected = model.observe(x, b)
    found = add_sums(model.observe(block.kept[:, :3], block.kept[:, 3:]), model.cells, block)
    for one, other in (
        (found.gram.stencil, expected.gram.stencil), (found.gram.border, expected.gram.border),
        (found.gram.corner, expected.gram.corner), (found.eta, expected.eta), (found.square, expected.square),
        (found.n_values, expected.n_values),
    ):  # fmt: skip
        np.testing.assert_allclose(one, other, rtol=1e-9, atol=1e-12 * np.abs(other).max())
