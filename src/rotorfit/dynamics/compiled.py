"""Options of compiled functions.

`kernel` is for functions called from Python, which release its lock; `inner` for those called only by other compiled
functions: the wrappers for calls from Python are left out, which saves a sixth of the compile time or more. Called from
Python they crash. Neither needs the wrapper for calls from C.

Array products, sums of slices and the like take seconds to compile, loops do not: kernels are written as loops.
"""

import functools

import numba

kernel = functools.partial(numba.njit, cache=True, error_model="numpy", nogil=True, no_cfunc_wrapper=True)
inner = functools.partial(numba.njit, cache=True, error_model="numpy", no_cpython_wrapper=True, no_cfunc_wrapper=True)
