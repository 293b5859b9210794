"""Force laws: one compiled function each, called by engine, compiled back end and pictures.

A law is a C function ``f(x, v, t, p) -> force`` of a coordinate ``x`` [m or rad], its rate ``v``
[m/s or rad/s], the time ``t`` [s] and a pointer ``p`` to its constants.  It is stated once, with
:func:`force_law`, and called through its address, so no caller has to be compiled again when a law
is added.  A law that remembers is stated with :func:`memory_law`.  Both are compiled when they are
first asked for: a run uses few of the catalogue's.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
from llvmlite import ir  # type: ignore[import-untyped]
from numba import types
from numba.extending import intrinsic

from physid.plant.compiling import kept, kept_c_function

_NUMBERS: Any = types.CPointer(types.float64)  # type: ignore[no-untyped-call]
LAW_SIGNATURE = types.float64(types.float64, types.float64, types.float64, _NUMBERS)
MEMORY_SIGNATURE = types.float64(
    types.float64, types.float64, types.float64, _NUMBERS, _NUMBERS, types.int64
)


@dataclass(frozen=True)
class Law:
    """A law and its C function, compiled when that is first asked for.

    What numba cannot compile raises then, one of its own errors or another.

    Attributes
    ----------
    function : callable
        As it was stated.
    signature : numba signature
        :data:`LAW_SIGNATURE` or :data:`MEMORY_SIGNATURE`.
    """

    function: Callable[..., float]
    signature: Any

    @cached_property
    def compiled(self) -> Any:
        """The C function (numba CFunc), kept between runs."""
        return kept_c_function(self.signature, error_model="numpy")(self.function)

    @property
    def address(self) -> int:
        """Where the C function is: what elements carry."""
        return int(self.compiled.address)

    @property
    def ctypes(self) -> Any:
        """The C function, to be called from Python."""
        return self.compiled.ctypes


def force_law(function: Callable[..., float]) -> Law:
    """State a force law ``f(x, v, t, p)`` in the subset of Python that numba compiles."""
    return Law(function, LAW_SIGNATURE)


def memory_law(function: Callable[..., float]) -> Law:
    """State a force law with a memory z of its own, which obeys a differential equation.

    Parameters
    ----------
    function : callable
        ``f(x, v, t, p, z, part)`` in the subset of Python that numba compiles: the force for part 0,
        dz/dt of entry k of the memory for part k + 1.
    """
    return Law(function, MEMORY_SIGNATURE)


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
