# SPDX-License-Identifier: BSD-3-Clause
"""Cells and nodes against what their definition says, one by one."""

import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st

from magmatch.field.cholesky.cells import count_active_cells, lay_cells

SPACING = 0.25
# Of a node's place within a cell: which of the four nodes along each axis.
LOCAL = np.array(list(np.ndindex(4, 4, 4)))


def survey(seed):
    """Samples in two heaps, of which one may be flat, far from the lattice's origin."""
    rng = np.random.default_rng(seed)
    size = rng.uniform(0, 1.2, 3) * rng.integers(0, 2, 3)
    return np.concatenate([rng.uniform(0, 1, (9, 3)) * size, [[1.9, 0.3, -0.4]]]) + rng.uniform(-3, 3, 3)


def defined(x, reach):
    """Of all lattice cells near samples: index, and distance to the nearest occupied one."""
    occupied = np.unique(np.floor(x / SPACING + 0.5).astype(int), axis=0)
    low, high = occupied.min(axis=0) - int(reach), occupied.max(axis=0) + int(reach)
    every = low + np.array(list(np.ndindex(*(high - low + 1))))
    away = np.linalg.norm(every[:, None] - occupied, axis=2).min(axis=1)
    return every[away <= reach + 1e-9], away[away <= reach + 1e-9], len(every)


@given(seed=st.integers(0, 10**6), reach=st.sampled_from([0.0, 1.0, 1.5, 2.5]))
@settings(deadline=None, max_examples=15)
def test_cells_are_those_within_reach_and_nodes_those_that_touch_them(seed, reach):
    x = survey(seed)
    found, (expected, away, n_box) = lay_cells(x, SPACING, reach), defined(x, reach)
    np.testing.assert_array_equal(found.cells + found.first, expected)
    np.testing.assert_allclose(found.distance, away, rtol=1e-6)
    assert count_active_cells(x, SPACING, reach, n_box) == len(expected)
    assert count_active_cells(x, SPACING, reach, n_box - 1) == np.inf
    nodes = np.unique((found.cells[:, None] + LOCAL).reshape(-1, 3), axis=0)
    np.testing.assert_array_equal(found.nodes, nodes)
    np.testing.assert_array_equal(found.nodes[found.cell_nodes], found.cells[:, None] + LOCAL)
    np.testing.assert_array_equal(found.cell_index[tuple(found.cells.T)], np.arange(found.n_cells))
    assert (found.cell_index >= 0).sum() == found.n_cells
    np.testing.assert_array_equal(found.node_index.ravel()[found.flat_nodes], np.arange(found.n_nodes))
    assert (found.node_index >= 0).sum() == found.n_nodes
