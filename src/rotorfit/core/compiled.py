"""Options of compiled functions.

`kernel` is for functions called from Python, which release its lock; `inner` for those called only by other compiled
functions: the wrappers for calls from Python are left out, which saves a sixth of the compile time or more. Called from
Python they crash. Neither needs the wrapper for calls from C.

Array products, sums of slices and the like take seconds to compile, loops do not: kernels are written as loops.
"""

import functools
from collections.abc import Callable
from typing import Any

import numba
from numba.core.caching import FunctionCache
from numba.core.runtime.nrt import rtsys


class _ReadyCode(FunctionCache):
    """A cache that loads compiled code without what only a compiler needs.

    numba imports and registers every function that it could compile before it looks into its cache, which costs a new
    process more than reading the code. Where nothing is found the compiler does so itself.
    """

    def load_overload(self, sig: Any, target_context: Any) -> Any:
        """The compiled code of a signature; None where it is not in the cache."""
        rtsys.initialize(target_context)
        with self._guard_against_spurious_io_errors():
            return self._load_overload(sig, target_context)  # type: ignore[no-untyped-call]


def _compiled(**options: Any) -> Callable[[Callable[..., Any]], Any]:
    """A decorator that compiles a function when it is first called, and keeps its code on the disk."""
    jit: Any = functools.partial(numba.njit, cache=True, error_model="numpy", no_cfunc_wrapper=True, **options)

    def decorate(function: Callable[..., Any]) -> Any:
        compiled = jit(function)
        if compiled is not function:  # NUMBA_DISABLE_JIT gives the function back
            compiled._cache = _ReadyCode(function)  # type: ignore[no-untyped-call]
        return compiled

    return decorate


kernel = functools.partial(_compiled, nogil=True)
inner = functools.partial(_compiled, no_cpython_wrapper=True)
