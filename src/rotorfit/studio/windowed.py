"""Windows of long series: what a plot of so many pixels can show, and no more; every value where it can show them."""

from dataclasses import dataclass

import numpy as np

from rotorfit.frames import Array
from rotorfit.views import extremes

DENSE = 4
"""Samples a pixel up to which a window is given whole."""


@dataclass(frozen=True)
class Window:
    """A part of a series, ready to draw.

    Attributes:
        time: Increasing stamps, shape (N,) [s].
        values: Shape (N, K), NaN where there is none.
        exact: Whether these are all the samples; else the smallest and the largest of each of `width` stretches.
        count: Samples in the window.
    """

    time: Array
    values: Array
    exact: bool
    count: int


def window_of(time: Array, values: Array, start: float, end: float, width: int) -> Window:
    """The samples of a window, reduced to the extremes of its pixels where there are many.

    One sample on each side goes with it, so that lines run to the edges.

    Args:
        time: Non-decreasing stamps, shape (N,) [s].
        values: Shape (N, K).
        start: Of the window [s].
        end: Of the window [s].
        width: Pixels.
    """
    first = max(int(np.searchsorted(time, start, side="left")) - 1, 0)
    last = min(int(np.searchsorted(time, end, side="right")) + 1, time.size)
    own_time, own = time[first:last], values[first:last]
    if own_time.size <= DENSE * width or own_time[-1] <= own_time[0]:
        return Window(own_time, own, True, own_time.size)
    reduced_time, reduced = extremes(own_time, own, width)
    return Window(reduced_time, reduced, False, own_time.size)


def packed(window: Window) -> bytes:
    """Little-endian bytes: the stamps as float64, then column after column as float32."""
    return window.time.astype("<f8").tobytes() + window.values.T.astype("<f4").tobytes()
