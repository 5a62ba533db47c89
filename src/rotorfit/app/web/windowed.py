"""Windows of long series: what a plot of so many pixels can show, and no more; every value where it can show them."""

from dataclasses import dataclass

import numpy as np

from rotorfit.core.frames import Array
from rotorfit.reporting.views import extremes

DENSE = 4
"""Samples a pixel up to which a window is given whole."""

COARSE = 64
"""Samples a stretch of the coarse series, from which windows of more than that a pixel are made."""


@dataclass(frozen=True)
class Series:
    """Columns over time.

    Attributes:
        time: Non-decreasing, shape (N,) [s].
        values: Shape (N, K), a column in one piece.
        coarse: Extremes of stretches of about `COARSE` samples; None for a short series.
    """

    time: Array
    values: Array
    coarse: tuple[Array, Array] | None = None


@dataclass(frozen=True)
class Window:
    """A part of a series, ready to draw.

    Attributes:
        time: Non-decreasing stamps, shape (N,) [s].
        values: Shape (N, K), NaN where there is none.
        exact: Whether these are all the samples; else the smallest and the largest of each of `width` stretches.
        count: Samples in the window.
    """

    time: Array
    values: Array
    exact: bool
    count: int


def series_over(time: Array, values: Array) -> Series:
    """A series, with what makes long windows quick."""
    values = np.asfortranarray(values)
    if time.size < COARSE * COARSE or not time[-1] > time[0]:
        return Series(time, values)
    return Series(time, values, extremes(time, values, time.size // COARSE))


def window_of(series: Series, start: float, end: float, width: int) -> Window:
    """The samples of a window, reduced to the extremes of its pixels where there are many.

    One sample on each side goes with it, so that lines run to the edges. Where a pixel holds more than `COARSE` samples
    its extremes may stand in the neighbouring one.

    Args:
        series: Whole.
        start: Of the window [s].
        end: Of the window [s].
        width: Pixels.
    """
    first, last = _between(series.time, start, end)
    count = last - first
    time, values = series.time, series.values
    if series.coarse is not None and count > COARSE * width:
        time, values = series.coarse
        first, last = _between(time, start, end)
    time, values = time[first:last], values[first:last]
    if count <= DENSE * width or time[-1] <= time[0]:
        return Window(time, values, True, count)
    return Window(*extremes(time, values, width), False, count)


def _between(time: Array, start: float, end: float) -> tuple[int, int]:
    """First sample and one past the last of a window, with one more on each side."""
    first = int(np.searchsorted(time, start, side="left")) - 1
    return max(first, 0), min(int(np.searchsorted(time, end, side="right")) + 1, time.size)


def packed(window: Window) -> bytes:
    """Little-endian bytes: the stamps as float64, then column after column as float32."""
    return window.time.astype("<f8").tobytes() + window.values.T.astype("<f4").tobytes()
