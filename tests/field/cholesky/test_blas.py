# SPDX-License-Identifier: BSD-3-Clause
"""Compiled calls of BLAS and LAPACK against NumPy, in both precisions."""

import numpy as np
import pytest
from numba import njit

from magmatch.field.cholesky import blas

TOLERANCE = {np.float64: 1e-12, np.float32: 2e-4}


@njit
def all_of(A, X, L, Z):
    failed = blas.cholesky(A)
    blas.divide_right_transposed(A, X)
    S = np.zeros((X.shape[0], X.shape[0]), X.dtype).T
    blas.subtract_square(X, S, False)
    blas.subtract_square(X, S, True)
    blas.invert_triangle(L)
    W = X.copy().T.copy().T
    blas.multiply_right(L, W)
    V = W.copy().T.copy().T
    blas.minus_symmetric_product(Z, W, V)
    Q = L.copy().T.copy().T
    blas.square_transposed(Q)
    blas.subtract_transposed_product(W, V, Q)
    return failed, S, W, V, Q


@pytest.mark.parametrize("precision", [np.float64, np.float32])
@pytest.mark.parametrize(("n", "k"), [(1, 1), (5, 3), (150, 201)])
def test_compiled_routines_equal_numpy(n, k, precision):
    rng = np.random.default_rng(n)
    full = rng.normal(size=(n, n)) / np.sqrt(n)
    A, X = full @ full.T + np.eye(n), rng.normal(size=(k, n))
    Z = rng.normal(size=(k, k)) / np.sqrt(k)
    Z = Z + Z.T
    L = np.linalg.cholesky(A)
    expected_X = np.linalg.solve(L, X.T).T
    W = expected_X @ np.linalg.inv(L)
    arrays = [np.asfortranarray(a.astype(precision)) for a in (A, X, L, np.tril(Z))]
    failed, S, found_W, V, Q = all_of(*arrays)
    close = {"atol": TOLERANCE[precision] * 10}
    assert failed == 0
    np.testing.assert_allclose(np.tril(arrays[0]), L, **close)
    np.testing.assert_allclose(arrays[1], expected_X, **close)
    np.testing.assert_allclose(np.tril(S), np.tril(-2 * expected_X @ expected_X.T), **close)
    np.testing.assert_allclose(found_W, W, **close)
    np.testing.assert_allclose(V, -Z @ W, **close)
    np.testing.assert_allclose(np.tril(Q), np.tril(np.linalg.inv(A) + W.T @ Z @ W), **close)
    assert all(a.dtype == precision for a in (S, found_W, V, Q))


@njit
def factor(A):
    return blas.cholesky(A)


def test_a_failing_pivot_is_named():
    A = np.asfortranarray(np.diag([1.0, 2.0, -1.0, 1.0]))
    assert factor(A) == 3
