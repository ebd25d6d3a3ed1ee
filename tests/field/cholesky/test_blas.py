# SPDX-License-Identifier: BSD-3-Clause
"""Compiled calls of BLAS and LAPACK against NumPy, in both precisions."""

import numpy as np
import pytest
from numba import njit

from magmatch.field.cholesky.blas import (
    LEFT,
    LOWER,
    NOT_UNIT,
    PLAIN,
    RIGHT,
    TRANSPOSED,
    address_of,
    gemm,
    lacpy,
    lauum,
    potrf,
    symm,
    syrk,
    trmm,
    trsm,
    trtri,
)

TOLERANCE = {np.float64: 1e-12, np.float32: 2e-4}


@njit
def all_of(is_single, A, X, L, Z, S, W, V, Q, G, info):
    n, k = np.int32(X.shape[1]), np.int32(X.shape[0])
    potrf(is_single, LOWER, n, A, n, info)
    trsm(is_single, RIGHT, LOWER, TRANSPOSED, NOT_UNIT, k, n, 1.0, A, n, X, k)
    syrk(is_single, LOWER, PLAIN, k, n, -1.0, X, k, 0.0, S, k)
    syrk(is_single, LOWER, PLAIN, k, n, -1.0, X, k, 1.0, S, k)
    trtri(is_single, LOWER, NOT_UNIT, n, L, n, info)
    lacpy(is_single, PLAIN, k, n, X, k, W, k)
    trmm(is_single, RIGHT, LOWER, PLAIN, NOT_UNIT, k, n, 1.0, L, n, W, k)
    symm(is_single, LEFT, LOWER, k, n, -1.0, Z, k, W, k, 0.0, V, k)
    lacpy(is_single, LOWER, n, n, address_of(L), n, Q, n)
    lauum(is_single, LOWER, n, Q, n, info)
    gemm(is_single, TRANSPOSED, PLAIN, n, n, k, 1.0, W, k, V, k, 0.0, address_of(G), n)


@pytest.mark.parametrize("precision", [np.float64, np.float32])
@pytest.mark.parametrize(("n", "k"), [(2, 2), (5, 3), (150, 201)])
def test_compiled_routines_equal_numpy(n, k, precision):
    rng = np.random.default_rng(n)
    full = rng.normal(size=(n, n)) / np.sqrt(n)
    A, X = full @ full.T + np.eye(n), rng.normal(size=(k, n))
    Z = rng.normal(size=(k, k)) / np.sqrt(k)
    Z = Z + Z.T
    L = np.linalg.cholesky(A)
    expected_X = np.linalg.solve(L, X.T).T
    W = expected_X @ np.linalg.inv(L)
    factored, solved, inverse, lower_Z = (np.asfortranarray(a.astype(precision)) for a in (A, X, L, np.tril(Z)))
    S, found_W, V, Q, G = (np.zeros(s, precision, order="F") for s in ((k, k), (k, n), (k, n), (n, n), (n, n)))
    info = np.zeros(1, np.int32)
    all_of(precision is np.float32, factored, solved, inverse, lower_Z, S, found_W, V, Q, G, info)
    close = {"atol": TOLERANCE[precision] * 10}
    assert info[0] == 0
    np.testing.assert_allclose(np.tril(factored), L, **close)
    np.testing.assert_allclose(solved, expected_X, **close)
    np.testing.assert_allclose(np.tril(S), np.tril(-2 * expected_X @ expected_X.T), **close)
    np.testing.assert_allclose(found_W, W, **close)
    np.testing.assert_allclose(V, -Z @ W, **close)
    np.testing.assert_allclose(np.tril(Q), np.tril(np.linalg.inv(A)), **close)
    np.testing.assert_allclose(G, -W.T @ Z @ W, **close)
