# SPDX-License-Identifier: BSD-3-Clause
"""BLAS and LAPACK for compiled loops: SciPy's own routines in double and single precision.

The wrappers in `scipy.linalg` hold the interpreter while they run, so the halves of a task would take turns. All
matrices are stored column by column and contiguous; of symmetric ones only the lower triangle counts.
"""

from typing import Any

import llvmlite.binding
import numpy as np
from llvmlite import ir
from numba import types
from numba.core import cgutils
from numba.extending import get_cython_function_address, intrinsic, overload

_COMPILED_ONLY = "only for compiled code"
_LETTERS = {types.float64: "d", types.float32: "s"}
# Columns that are worked on at once: wide enough for the matrix products to be fast, and they do the rest.
STRIP = 64
LOWER, LEFT, RIGHT, PLAIN, TRANSPOSED, NOT_UNIT = (np.uint8(ord(letter)) for letter in "LLRNTN")


def _routines(module: str, name: str, n_arguments: int) -> dict[Any, Any]:
    """A routine for each precision; compiled code that was cached finds it by its symbol."""
    out = {}
    for kind, letter in _LETTERS.items():
        symbol = f"magmatch_{letter}{name}"
        address = get_cython_function_address(f"scipy.linalg.cython_{module}", letter + name)
        llvmlite.binding.add_symbol(symbol, address)
        out[kind] = types.ExternalFunction(symbol, types.void(*[types.intp] * n_arguments))
    return out


_GEMM, _SYRK, _SYMM = _routines("blas", "gemm", 13), _routines("blas", "syrk", 10), _routines("blas", "symm", 12)
_TRSM, _TRMM = _routines("blas", "trsm", 11), _routines("blas", "trmm", 11)
_POTRF, _LAUUM = _routines("lapack", "potrf", 5), _routines("lapack", "lauum", 5)
_TRTRI = _routines("lapack", "trtri", 6)


def _place(typing_context: Any, value: Any) -> Any:  # noqa: ARG001
    """Address of a number, as Fortran takes everything by reference."""

    def place(context: Any, builder: ir.IRBuilder, signature: Any, args: Any) -> Any:  # noqa: ARG001
        slot = cgutils.alloca_once_value(builder, args[0])  # type: ignore[no-untyped-call]
        return builder.ptrtoint(slot, context.get_value_type(types.intp))

    return types.intp(value), place


_at: Any = intrinsic(_place)


def _number(kind: Any) -> Any:
    return np.float64 if kind is types.float64 else np.float32


def cholesky(A: np.ndarray) -> int:
    """Overwrite the lower triangle of A with its Cholesky factor; the 1-based pivot that fails, 0 where none does."""
    raise NotImplementedError(_COMPILED_ONLY, A)


def divide_right_transposed(L: np.ndarray, X: np.ndarray) -> None:
    """Overwrite X with ``X L^-T``."""
    raise NotImplementedError(_COMPILED_ONLY, L, X)


def subtract_square(X: np.ndarray, S: np.ndarray, keep: bool) -> None:
    """Subtract ``X X^T`` from the lower triangle of S, or from 0."""
    raise NotImplementedError(_COMPILED_ONLY, X, S, keep)


def invert_triangle(L: np.ndarray) -> None:
    """Overwrite a lower triangle with its inverse."""
    raise NotImplementedError(_COMPILED_ONLY, L)


def square_transposed(L: np.ndarray) -> None:
    """Overwrite a lower triangle L with that of ``L^T L``."""
    raise NotImplementedError(_COMPILED_ONLY, L)


def multiply_right(L: np.ndarray, W: np.ndarray) -> None:
    """Overwrite W with ``W L``, L a lower triangle."""
    raise NotImplementedError(_COMPILED_ONLY, L, W)


def minus_symmetric_product(Z: np.ndarray, W: np.ndarray, out: np.ndarray) -> None:
    """Write ``-Z W`` to out, Z symmetric."""
    raise NotImplementedError(_COMPILED_ONLY, Z, W, out)


def subtract_transposed_product(V: np.ndarray, W: np.ndarray, Z: np.ndarray) -> None:
    """Subtract the symmetric ``V^T W`` from the lower triangle of Z; above it anything may be left."""
    raise NotImplementedError(_COMPILED_ONLY, V, W, Z)


@overload(cholesky, strict=False)
def _cholesky(A: Any) -> Any:
    potrf = _POTRF[A.dtype]

    def run(A):  # type: ignore[no-untyped-def]
        n, info = np.int32(A.shape[0]), np.zeros(1, np.int32)
        potrf(_at(LOWER), _at(n), A.ctypes.data, _at(n), info.ctypes.data)
        return info[0]

    return run


@overload(divide_right_transposed, strict=False)
def _divide_right_transposed(L: Any, X: Any) -> Any:  # noqa: ARG001
    trsm, gemm, one, size = _TRSM[X.dtype], _GEMM[X.dtype], _number(X.dtype)(1.0), X.dtype.bitwidth // 8

    def run(L, X):  # type: ignore[no-untyped-def]
        m, n = np.int32(X.shape[0]), np.int32(X.shape[1])
        for j in range(0, n, STRIP):
            width, before = np.int32(min(STRIP, int(n) - j)), np.int32(j)
            block, row = X.ctypes.data + size * j * m, L.ctypes.data + size * j
            if j > 0:
                gemm(
                    _at(PLAIN), _at(TRANSPOSED), _at(m), _at(width), _at(before), _at(-one), X.ctypes.data, _at(m),
                    row, _at(n), _at(one), block, _at(m),
                )  # fmt: skip
            trsm(
                _at(RIGHT), _at(LOWER), _at(TRANSPOSED), _at(NOT_UNIT), _at(m), _at(width), _at(one),
                row + size * j * n, _at(n), block, _at(m),
            )  # fmt: skip

    return run


@overload(subtract_square, strict=False)
def _subtract_square(X: Any, S: Any, keep: Any) -> Any:  # noqa: ARG001
    syrk, one = _SYRK[X.dtype], _number(X.dtype)(1.0)

    def run(X, S, keep):  # type: ignore[no-untyped-def]
        n, k, kept = np.int32(X.shape[0]), np.int32(X.shape[1]), keep * one
        syrk(
            _at(LOWER), _at(PLAIN), _at(n), _at(k), _at(-one), X.ctypes.data, _at(n), _at(kept), S.ctypes.data, _at(n)
        )

    return run


@overload(invert_triangle, strict=False)
def _invert_triangle(L: Any) -> Any:
    trtri = _TRTRI[L.dtype]

    def run(L):  # type: ignore[no-untyped-def]
        n, info = np.int32(L.shape[0]), np.zeros(1, np.int32)
        trtri(_at(LOWER), _at(NOT_UNIT), _at(n), L.ctypes.data, _at(n), info.ctypes.data)
        return info[0]

    return run


@overload(square_transposed, strict=False)
def _square_transposed(L: Any) -> Any:
    lauum = _LAUUM[L.dtype]

    def run(L):  # type: ignore[no-untyped-def]
        n, info = np.int32(L.shape[0]), np.zeros(1, np.int32)
        lauum(_at(LOWER), _at(n), L.ctypes.data, _at(n), info.ctypes.data)
        return info[0]

    return run


@overload(multiply_right, strict=False)
def _multiply_right(L: Any, W: Any) -> Any:  # noqa: ARG001
    trmm, one = _TRMM[W.dtype], _number(W.dtype)(1.0)

    def run(L, W):  # type: ignore[no-untyped-def]
        m, n = np.int32(W.shape[0]), np.int32(W.shape[1])
        trmm(
            _at(RIGHT), _at(LOWER), _at(PLAIN), _at(NOT_UNIT), _at(m), _at(n), _at(one), L.ctypes.data, _at(n),
            W.ctypes.data, _at(m),
        )  # fmt: skip

    return run


@overload(minus_symmetric_product, strict=False)
def _minus_symmetric_product(Z: Any, W: Any, out: Any) -> Any:  # noqa: ARG001
    symm, one, zero = _SYMM[W.dtype], _number(W.dtype)(1.0), _number(W.dtype)(0.0)

    def run(Z, W, out):  # type: ignore[no-untyped-def]
        m, n = np.int32(W.shape[0]), np.int32(W.shape[1])
        symm(
            _at(LEFT), _at(LOWER), _at(m), _at(n), _at(-one), Z.ctypes.data, _at(m), W.ctypes.data, _at(m),
            _at(zero), out.ctypes.data, _at(m),
        )  # fmt: skip

    return run


@overload(subtract_transposed_product, strict=False)
def _subtract_transposed_product(V: Any, W: Any, Z: Any) -> Any:  # noqa: ARG001
    gemm, one, size = _GEMM[W.dtype], _number(W.dtype)(1.0), W.dtype.bitwidth // 8

    def run(V, W, Z):  # type: ignore[no-untyped-def]
        k, n = np.int32(W.shape[0]), np.int32(W.shape[1])
        for j in range(0, n, STRIP):
            rows, columns, start = np.int32(n - j), np.int32(min(STRIP, int(n) - j)), size * j * k
            gemm(
                _at(TRANSPOSED), _at(PLAIN), _at(rows), _at(columns), _at(k), _at(-one), V.ctypes.data + start,
                _at(k), W.ctypes.data + start, _at(k), _at(one), Z.ctypes.data + size * j * (n + 1), _at(n),
            )  # fmt: skip

    return run
