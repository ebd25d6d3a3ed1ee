# SPDX-License-Identifier: BSD-3-Clause
"""The factor of a sparse matrix of blocks against dense algebra."""

import numpy as np
import pytest

from magmatch.slam.graph.block_cholesky import BlockCholesky, sum_of_blocks


def chain_with_loops(n, n_loops, is_planar, rng):
    """A chain with loops, all coupled to a last block; in the plane each half of a block is a chain itself."""
    pairs = [(k, k + 1) for k in range(n - 2)] + [tuple(rng.choice(n - 1, 2, replace=False)) for _ in range(n_loops)]
    coupled = np.kron(np.eye(2), np.ones((3, 3))) if is_planar else np.ones((6, 6))
    rows, columns, blocks = list(range(n)), list(range(n)), [1e-2 * np.eye(6)] * n
    for pair in pairs:
        some = sorted([*pair, n - 1])
        J = [(np.eye(6) + 0.3 * rng.normal(size=(6, 6))) * coupled for _ in some]
        for a in range(3):
            for b in range(a + 1):
                rows.append(some[a])
                columns.append(some[b])
                blocks.append(J[a].T @ J[b])
    A = sum_of_blocks(np.array(rows), np.array(columns), np.array(blocks), n)
    lower = np.tril(A.toarray())
    return A, lower + np.tril(lower, -1).T


@pytest.mark.parametrize("is_planar", [False, True])
@pytest.mark.parametrize("n_loops", [0, 1, 12])
def test_solutions_determinant_and_blocks_of_the_inverse_are_those_of_the_dense_matrix(n_loops, is_planar):
    n, rng = 30, np.random.default_rng(n_loops)
    A, dense = chain_with_loops(n, n_loops, is_planar, rng)
    factor, inverse = BlockCholesky.of(A), np.linalg.inv(dense)
    rhs = rng.normal(size=(n, 6, 6))
    rhs[1:, :, 0] = 0.0
    scale = np.abs(inverse).max()
    np.testing.assert_allclose(
        factor.solve(rhs).reshape(6 * n, 6), inverse @ rhs.reshape(6 * n, 6), atol=1e-9 * scale
    )
    np.testing.assert_array_equal(factor.solve(rhs[:, :, :1]), factor.solve(rhs)[:, :, :1])
    assert factor.log_determinant == pytest.approx(np.linalg.slogdet(dense)[1], rel=1e-12)
    own = inverse.reshape(n, 6, n, 6)[np.arange(n), :, np.arange(n)]
    np.testing.assert_allclose(factor.diagonal_of_inverse, own, atol=1e-9 * scale)
    found = factor.inverse_in_column(7)
    np.testing.assert_allclose(found, inverse.reshape(n, 6, n, 6)[:, :, 7], atol=1e-9 * scale)


def test_the_factor_of_a_large_loopy_chain_is_sparse():
    n = 400
    A, _ = chain_with_loops(n, 8, False, np.random.default_rng(0))
    assert len(BlockCholesky.of(A).rows) < 5 * n


def test_a_matrix_that_is_not_positive_definite_is_refused():
    A, _ = chain_with_loops(10, 2, False, np.random.default_rng(0))
    A.data[0] -= 1e3 * np.eye(6)
    with pytest.raises(np.linalg.LinAlgError, match="does not determine"):
        BlockCholesky.of(A)
