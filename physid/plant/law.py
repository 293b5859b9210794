"""Force laws: one compiled function each, called by engine, compiled back end and pictures.

A law is a C function ``f(x, v, t, p) -> force`` of a coordinate ``x`` [m or rad], its rate ``v``
[m/s or rad/s], the time ``t`` [s] and a pointer ``p`` to its constants.  It is stated once, with
:func:`force_law`, and called through its address, so no caller has to be compiled again when a law
is added.  A law that remembers is stated with :func:`memory_law`.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
from llvmlite import ir  # type: ignore[import-untyped]
from numba import types
from numba.extending import intrinsic

from physid.plant.compiling import kept, kept_c_function

_NUMBERS: Any = types.CPointer(types.float64)  # type: ignore[no-untyped-call]
LAW_SIGNATURE = types.float64(types.float64, types.float64, types.float64, _NUMBERS)


def force_law(function: Callable[..., float]) -> Any:
    """Compile a force law to a C function.

    Parameters
    ----------
    function : callable
        ``f(x, v, t, p)`` in the subset of Python that numba compiles.

    Returns
    -------
    numba CFunc
        ``.address`` is what elements carry; the compiled code is kept between runs.
    """
    return kept_c_function(LAW_SIGNATURE, error_model="numpy")(function)


MEMORY_SIGNATURE = types.float64(
    types.float64, types.float64, types.float64, _NUMBERS, _NUMBERS, types.int64
)


def memory_law(function: Callable[..., float]) -> Any:
    """Compile a force law with a memory z of its own, which obeys a differential equation.

    Parameters
    ----------
    function : callable
        ``f(x, v, t, p, z, part)`` in the subset of Python that numba compiles: the force for part 0,
        dz/dt of entry k of the memory for part k + 1.

    Returns
    -------
    numba CFunc
        See :func:`force_law`.
    """
    return kept_c_function(MEMORY_SIGNATURE, error_model="numpy")(function)


def _call_memory_law(typingctx, address, x, v, t, constants, memory, part):  # type: ignore[no-untyped-def]
    """Call the law with a memory at an address from compiled code."""
    signature = types.float64(
        types.int64, types.float64, types.float64, types.float64, _NUMBERS, _NUMBERS, types.int64
    )

    def codegen(context, builder, _signature, arguments):  # type: ignore[no-untyped-def]
        double = ir.DoubleType()
        numbers = double.as_pointer()
        taken = [double, double, double, numbers, numbers, ir.IntType(64)]
        target = builder.inttoptr(arguments[0], ir.FunctionType(double, taken).as_pointer())
        return builder.call(target, arguments[1:])

    return signature, codegen


def _call_law(typingctx, address, x, v, t, constants):  # type: ignore[no-untyped-def]
    """Call the law at an address from compiled code (a plain C call, about 2 ns)."""
    signature = types.float64(types.int64, types.float64, types.float64, types.float64, _NUMBERS)

    def codegen(context, builder, _signature, arguments):  # type: ignore[no-untyped-def]
        double = ir.DoubleType()
        prototype = ir.FunctionType(double, [double, double, double, double.as_pointer()])
        target = builder.inttoptr(arguments[0], prototype.as_pointer())
        return builder.call(target, arguments[1:])

    return signature, codegen


def _pointer_at(typingctx, address):  # type: ignore[no-untyped-def]
    """Turn an integer address into a pointer to doubles."""
    signature = _NUMBERS(types.int64)

    def codegen(context, builder, _signature, arguments):  # type: ignore[no-untyped-def]
        return builder.inttoptr(arguments[0], ir.DoubleType().as_pointer())

    return signature, codegen


call_law: Any = intrinsic(_call_law)
call_memory_law: Any = intrinsic(_call_memory_law)
pointer_at: Any = intrinsic(_pointer_at)


@kept
def _evaluate(address, x, v, t, constants, out):  # type: ignore[no-untyped-def]
    pointer = pointer_at(constants.ctypes.data)
    for i in range(x.size):
        out[i] = call_law(address, x[i], v[i], t[i], pointer)


def evaluate(
    address: int, x: np.ndarray, v: np.ndarray, t: np.ndarray, constants: np.ndarray
) -> np.ndarray:
    """Evaluate a law on arrays.

    Parameters
    ----------
    address : int
        Of a law made by :func:`force_law`.
    x, v, t : ndarray (n,)
        Coordinate [m or rad], its rate [per s], time [s].
    constants : ndarray (k,)
        The law's constants.

    Returns
    -------
    ndarray (n,)
        Force on the coordinate [N or N m].
    """
    out = np.empty_like(x, dtype=float)
    _evaluate(
        address,
        x.astype(float),
        v.astype(float),
        t.astype(float),
        np.ascontiguousarray(constants, dtype=float),
        out,
    )
    return out
