"""How compiled functions are compiled.

`kernel` is for those that Python calls; `inner` for those that other compiled functions call, and nothing else: what
would let Python call them is left out, as it takes a sixth of their compiling or more. Called from Python they crash.

Products of arrays, sums of slices and the like compile for seconds where a loop takes none: kernels are written out.
"""

import functools

import numba

kernel = functools.partial(numba.njit, cache=True, error_model="numpy")
inner = functools.partial(numba.njit, cache=True, error_model="numpy", no_cpython_wrapper=True, no_cfunc_wrapper=True)
