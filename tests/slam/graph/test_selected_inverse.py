# SPDX-License-Identifier: BSD-3-Clause
"""Blocks of a sparse inverse against the dense one."""

import numpy as np
import pytest
from scipy.sparse import csc_array

from magmatch.slam.graph.selected_inverse import factorised, inverse_blocks


@pytest.mark.parametrize("is_planar", [False, True])
@pytest.mark.parametrize("n_loops", [0, 1, 12])
def test_blocks_are_those_of_the_dense_inverse(n_loops, is_planar):
    rng, n = np.random.default_rng(n_loops), 30
    # A chain with loops, and two unknowns that all share; in the plane each half of a node is a chain of its own.
    H = np.zeros((6 * n + 2, 6 * n + 2))
    pairs = [(k, k + 1) for k in range(n - 1)] + [tuple(rng.choice(n, 2, replace=False)) for _ in range(n_loops)]
    for i, j in pairs:
        J = np.zeros((6, 6 * n + 2))
        coupled = np.kron(np.eye(2), np.ones((3, 3))) if is_planar else np.ones((6, 6))
        for k in (i, j):
            J[:, 6 * k : 6 * k + 6] = (np.eye(6) + 0.3 * rng.normal(size=(6, 6))) * coupled
        J[:3, 6 * n :] = rng.normal(size=(3, 2))
        H += J.T @ J
    H += 1e-2 * np.eye(len(H))
    dense = np.linalg.inv(H)[: 6 * n, : 6 * n].reshape(n, 6, n, 6)[np.arange(n), :, np.arange(n)]
    # Blocks are among the entries, zeros too.
    H = csc_array(
        np.where(np.kron(np.eye(n + 1), np.ones((6, 6)))[: len(H), : len(H)] + (H != 0), 1.0, 0.0) * 1.0 + H
    )
    H.data -= 1.0
    found = inverse_blocks(H, factorised(H), n, 6)
    np.testing.assert_allclose(found, dense, rtol=1e-9, atol=1e-9 * dense.max())
