"""Windows of long series, reduced to what the pixels of a plot can show; all samples if they fit."""

from dataclasses import dataclass

import numpy as np

from rotorfit.core.frames import Array
from rotorfit.reporting.views import extremes

DENSE = 4
"""Largest number of samples per pixel at which a window is not reduced."""

COARSE = 64
"""Number of samples behind a point of the coarse series, which serves windows with more samples per pixel than that."""


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
        exact: Whether these are all samples; otherwise they are the minimum and maximum for each pixel.
        count: Number of samples in the window.
    """

    time: Array
    values: Array
    exact: bool
    count: int


def series_over(time: Array, values: Array) -> Series:
    """A series, with the coarse series that makes long windows quick."""
    values = np.asfortranarray(values)
    if time.size < COARSE * COARSE or not time[-1] > time[0]:
        return Series(time, values)
    return Series(time, values, extremes(time, values, time.size // COARSE))


def window_of(series: Series, start: float, end: float, width: int) -> Window:
    """The samples of a window, reduced to the extremes in each pixel if there are many.

    One sample on each side is included, so that lines run to the edges. If a pixel holds more than `COARSE` samples,
    its extremes may appear in the neighbouring one.

    Args:
        series: The whole series.
        start: Start of the window [s].
        end: End of the window [s].
        width: Width of the plot [pixels].
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
    """Index of the first sample and one past the last of a window, with one more sample on each side."""
    first = int(np.searchsorted(time, start, side="left")) - 1
    return max(first, 0), min(int(np.searchsorted(time, end, side="right")) + 1, time.size)


def packed(window: Window) -> bytes:
    """The window as little-endian bytes: the stamps as float64, then column after column as float32.

    What float32 cannot hold is infinite there, which no picture shows.
    """
    with np.errstate(over="ignore"):
        values = window.values.T.astype("<f4")
    return window.time.astype("<f8").tobytes() + values.tobytes()
