# SPDX-License-Identifier: BSD-3-Clause
"""BLAS and LAPACK for compiled loops: SciPy's own routines in double and single precision.

The wrappers in `scipy.linalg` hold the interpreter while they run, so the halves of a task would take turns. Called
as in Fortran: matrices lie column by column, of symmetric ones only the lower triangle counts, every argument is
passed by its address. An array stands for its first entry, a 64-bit integer is an address itself, any other number
(sizes are 32-bit integers) is put into memory. Whether the matrices are single comes first: a loop has one signature.
"""

from inspect import Parameter, Signature
from typing import Any

import llvmlite.binding
import numpy as np
from llvmlite import ir
from numba import types
from numba.core import cgutils
from numba.extending import get_cython_function_address, intrinsic

# Columns that are worked on at once: wide enough for the matrix products to be fast, and they do the rest.
STRIP = 64
LOWER, LEFT, RIGHT, PLAIN, TRANSPOSED, NOT_UNIT = (np.uint8(ord(letter)) for letter in "LLRNTN")
_ADDRESS = ir.IntType(8).as_pointer()


def _routine(module: str, name: str, n_arguments: int) -> Any:
    """A routine in both precisions; compiled code that was cached finds it by its symbols."""
    symbols = [f"magmatch_{letter}{name}" for letter in "sd"]
    for symbol, letter in zip(symbols, "sd", strict=True):
        address = get_cython_function_address(f"scipy.linalg.cython_{module}", letter + name)
        llvmlite.binding.add_symbol(symbol, address)

    def call(typing_context: Any, is_single: Any, *kinds: Any) -> Any:  # noqa: ARG001
        kind_of_function = ir.FunctionType(ir.VoidType(), [_ADDRESS] * len(kinds))

        def emit(context: Any, builder: ir.IRBuilder, signature: Any, values: Any) -> Any:  # noqa: ARG001
            with builder.if_else(values[0]) as branches:
                for branch, symbol, number in zip(branches, symbols, (ir.FloatType(), ir.DoubleType()), strict=True):
                    with branch:
                        places = [
                            _place(context, builder, k, v, number) for k, v in zip(kinds, values[1:], strict=True)
                        ]
                        function = cgutils.get_or_insert_function(builder.module, kind_of_function, symbol)  # type: ignore[no-untyped-call]
                        builder.call(function, places)
            return context.get_dummy_value()

        return types.void(is_single, *kinds), emit

    names = ("typing_context", "is_single", *(f"argument_{k}" for k in range(n_arguments)))
    call.__signature__ = Signature([Parameter(n, Parameter.POSITIONAL_OR_KEYWORD) for n in names])  # type: ignore[attr-defined]
    return intrinsic(call)


def _place(context: Any, builder: ir.IRBuilder, kind: Any, value: Any, number: Any) -> Any:
    """Give the address at which Fortran finds an argument."""
    if kind == types.int64:
        return builder.inttoptr(value, _ADDRESS)
    if isinstance(kind, types.Array):
        place = context.make_array(kind)(context, builder, value).data
    else:
        if kind == types.float64 and number == ir.FloatType():
            value = builder.fptrunc(value, number)
        place = cgutils.alloca_once_value(builder, value)  # type: ignore[no-untyped-call]
    return builder.bitcast(place, _ADDRESS)


def _address(typing_context: Any, array: Any) -> Any:  # noqa: ARG001
    """Address of an array's first entry."""

    def emit(context: Any, builder: ir.IRBuilder, signature: Any, values: Any) -> Any:  # noqa: ARG001
        return builder.ptrtoint(context.make_array(array)(context, builder, values[0]).data, ir.IntType(64))

    return types.int64(array), emit


address_of: Any = intrinsic(_address)
gemm, syrk, symm = _routine("blas", "gemm", 13), _routine("blas", "syrk", 10), _routine("blas", "symm", 12)
trsm, trmm = _routine("blas", "trsm", 11), _routine("blas", "trmm", 11)
potrf, lauum, trtri = _routine("lapack", "potrf", 5), _routine("lapack", "lauum", 5), _routine("lapack", "trtri", 6)
gesv, lacpy = _routine("lapack", "gesv", 8), _routine("lapack", "lacpy", 7)
