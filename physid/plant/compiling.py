"""Compiled functions, kept between runs where that is possible and harmless where it is not.

Numba keeps compiled code beside the module or in the user's cache folder, keyed by the source's time
stamp, its own version and the processor.  Where neither folder can be written it would refuse;
here the function is compiled in every process instead, as are those of scripts: kept code is found
again under the name of its module, which a script has not.
"""

from __future__ import annotations

import sys
from collections.abc import Callable
from typing import Any

import numba
import numpy as np

BORROWING: dict[str, Any] = {"nogil": True, "error_model": "numpy", "_nrt": False}
"""Options of hot functions, which make no arrays: no references are counted in them.

Counting is an atomic operation per array, in loops too, and took up to half of a rig's step.
"""


def kept(function: Callable[..., Any] | None = None, **options: Any) -> Any:
    """Compile a function at its first call (``numba.njit``) and keep the code between runs."""

    def wrap(plain: Callable[..., Any]) -> Any:
        return _kept(numba.njit, plain, options)

    return wrap if function is None else wrap(function)


def kept_c_function(signature: Any, **options: Any) -> Callable[[Callable[..., Any]], Any]:
    """Compile a C function of a signature (``numba.cfunc``) and keep the code between runs.

    Values that the function takes from around it are part of the key under which it is kept.
    """

    def wrap(plain: Callable[..., Any]) -> Any:
        def compiled(**how: Any) -> Any:
            return numba.cfunc(signature, **how)

        return _kept(compiled, plain, options)

    return wrap


def _kept(compiler: Callable[..., Any], plain: Callable[..., Any], options: dict[str, Any]) -> Any:
    if getattr(sys.modules.get(plain.__module__), "__spec__", None) is None:
        return compiler(**options)(plain)
    try:
        return compiler(cache=True, **options)(plain)
    except RuntimeError:  # no folder for it can be written
        return compiler(**options)(plain)


@kept(error_model="numpy")
def product(one, other):  # type: ignore[no-untyped-def]
    """Return the product of small matrices (n, k) and (k, m), which compiles in a tenth of the time of BLAS's."""
    found = np.zeros((one.shape[0], other.shape[1]))
    for i in range(one.shape[0]):
        for k in range(one.shape[1]):
            for j in range(other.shape[1]):
                found[i, j] += one[i, k] * other[k, j]
    return found
