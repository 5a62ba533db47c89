"""The first-order low-pass of series on a grid: y_n = e y_(n-1) + (1 - e) x_n, from rest.

`scipy.signal` has it, too, but takes half a second to import.
"""

import numpy as np

from rotorfit.core.compiled import kernel
from rotorfit.core.frames import Array


def first_order_low_pass(values: Array, decay: float) -> Array:
    """The series, smoothed along their first axis.

    Args:
        values: Shape (N, ...).
        decay: What is left of y after a step, e = exp(-step / time constant).
    """
    columns = np.ascontiguousarray(values, float).reshape(len(values), -1)
    out = np.empty_like(columns)
    _fill_low_pass(columns, decay, out)
    return out.reshape(values.shape)


@kernel()
def _fill_low_pass(values: Array, decay: float, out: Array) -> None:
    """Fills the smoothed columns, both of shape (N, K)."""
    for k in range(values.shape[1]):
        state = 0.0
        for i in range(values.shape[0]):
            state = decay * state + (1 - decay) * values[i, k]
            out[i, k] = state
