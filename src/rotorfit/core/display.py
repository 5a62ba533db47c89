"""Display of result classes: data frames, tables in text and HTML, short texts of large values, figures.

This module depends on none of these classes, so that each can use it. polars and matplotlib are imported on first use.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, fields
from html import escape
from typing import TYPE_CHECKING, Any, Literal, Protocol

import numpy as np
import numpy.typing as npt

from rotorfit.core.errors import RotorfitError

if TYPE_CHECKING:
    from matplotlib.axes import Axes


class SupportsHtml(Protocol):
    """An object with an HTML representation."""

    def _repr_html_(self) -> str: ...


FrameLibrary = Literal["polars", "pandas"]

Ends = tuple[float | None, float | None]
"""Ends of an interval; None for an open one."""

LONG = 120
"""Length in characters above which a collection is only counted."""


def frame(columns: Mapping[str, Any], library: FrameLibrary = "polars") -> Any:
    """Columns as a data frame.

    Args:
        columns: Name to values, all of one length.
        library: `polars`, or `pandas`, which is imported only then.

    Returns:
        A `polars.DataFrame` or a `pandas.DataFrame`.

    Raises:
        RotorfitError: The library is neither of them.
        ModuleNotFoundError: pandas is requested but not installed.
    """
    if library == "polars":
        import polars as pl

        return pl.DataFrame(dict(columns))
    if library != "pandas":
        raise RotorfitError(f"no such library of data frames: {library!r}; known are 'polars' and 'pandas'")
    try:
        import pandas as pd
    except ModuleNotFoundError:
        raise ModuleNotFoundError("pandas is not installed; install it with: pip install pandas") from None
    return pd.DataFrame(dict(columns))


def columns_of(heads: Sequence[str], rows: Sequence[Sequence[Any]]) -> dict[str, list[Any]]:
    """Columns from rows; empty columns if there are no rows."""
    return {head: [row[place] for row in rows] for place, head in enumerate(heads)}


def counted(number: int, what: str) -> str:
    """`1 gap`, `2 gaps`."""
    return f"{number} {what}{'s' * (number != 1)}"


def number(value: float | None) -> str:
    """A number with four significant digits; `-` for None."""
    return "-" if value is None else f"{value:#.4g}".rstrip(".")


def interval(low: float | None, high: float | None) -> str:
    """`3.601 to 3.725`, with `open` for an open end; empty where both are open."""
    if low is None and high is None:
        return ""
    return " to ".join("open" if end is None else number(end) for end in (low, high))


def number_text(value: float, interval: Ends) -> str:
    """A number rounded to two digits of the half width of its interval."""
    return f"{value:z.{_decimals(value, interval)}f}"


def interval_text(interval: Ends) -> str:
    """A 95 % interval; `open` for an end that the data do not bound.

    An end that is small compared with the width keeps a digit where the interval excludes 0.
    """
    low, high = interval
    if low is None and high is None:
        return "-"
    known = [end for end in interval if end is not None]
    decimals, excluded = _decimals(max(known, key=abs), interval), len(known) == 2 and min(known) * max(known) > 0

    def text(end: float) -> str:
        least = -math.floor(math.log10(abs(end))) if excluded else 0
        return f"{end:z.{max(decimals, min(least, 6))}f}"

    return " to ".join("open" if end is None else text(end) for end in interval)


def _decimals(value: float, interval: Ends) -> int:
    low, high = interval
    half = abs(value) / 10 if low is None or high is None else (high - low) / 2
    return max(0, min(6, 1 - math.floor(math.log10(half)))) if half > 0 else 3


def text_table(title: str, heads: Sequence[str], rows: Sequence[Sequence[str]]) -> str:
    """A title above aligned columns."""
    widths = [max(len(row[place]) for row in (heads, *rows)) for place in range(len(heads))]
    lines = ("  ".join(map(str.ljust, row, widths)).rstrip() for row in (heads, *rows))
    return "\n".join([title, *lines]) if rows else title


def html_table(
    title: str, heads: Sequence[str], rows: Sequence[Sequence[str]], findings: Sequence[SupportsHtml] = ()
) -> str:
    """The same table as HTML, with the findings below it; all text is escaped."""

    def cells(tag: str, row: Sequence[str]) -> str:
        return "<tr>" + "".join(f"<{tag}>{escape(cell)}</{tag}>" for cell in row) + "</tr>"

    table = f"<table>{cells('th', heads)}{''.join(cells('td', row) for row in rows)}</table>" if rows else ""
    found = "".join(f"<li>{each._repr_html_()}</li>" for each in findings)
    return f"<div><p>{escape(title)}</p>{table}{f'<ul>{found}</ul>' if found else ''}</div>"


def short_repr(value: Any) -> str:
    """Representation of a dataclass; arrays and long collections are only counted."""
    shown = (f"{field.name}={_short(getattr(value, field.name))}" for field in fields(value) if field.repr)
    return f"{type(value).__name__}({', '.join(shown)})"


def _short(value: Any) -> str:
    if isinstance(value, np.ndarray):
        return f"<{value.dtype} array of shape {value.shape}>"
    if isinstance(value, Mapping | tuple | list) and len(text := _inside(value)) > LONG:
        return f"<{len(value)} {'entries' if isinstance(value, Mapping) else 'items'}>"
    return text if isinstance(value, Mapping | tuple | list) else repr(value)


def _inside(value: Mapping[Any, Any] | Sequence[Any]) -> str:
    """Text of a collection with its arrays counted; only as many entries as can still be short."""
    if isinstance(value, Mapping):
        return "{" + ", ".join(f"{key!r}: {_short(part)}" for key, part in list(value.items())[:LONG]) + "}"
    return "(" + ", ".join(map(_short, value[:LONG])) + ")"


AXIS_COLOURS = {"x": "#0b57b7", "y": "#b4470b", "z": "#1a7f37", "yaw": "#6f42c1"}

PREDICTOR_LOOKS: dict[str, dict[str, Any]] = {
    "model": {"color": "#0b57b7", "linewidth": 1.6, "marker": "o", "markersize": 3},
    "paper": {"color": "#b4470b", "linestyle": (0, (5, 2)), "marker": "o", "markersize": 3},
    "coast": {"color": "#8a6d00", "linestyle": (0, (4, 1.5, 1, 1.5)), "marker": "o", "markersize": 3},
    "hold": {"color": "#6f42c1", "linestyle": (0, (1, 1.5)), "marker": "o", "markersize": 3},
}
"""Line styles of the predictors, distinguishable without colour."""

OTHER_LOOK: dict[str, Any] = {
    "marker": "D",
    "color": "black",
    "fillstyle": "none",
    "markersize": 5,
    "linestyle": "none",
}

STYLE: dict[Any, Any] = {
    "axes.grid": True, "axes.axisbelow": True, "axes.spines.top": False, "axes.spines.right": False,
    "axes.titlelocation": "left", "axes.titlesize": 10, "grid.color": "#e4e4e4", "grid.linewidth": 0.6,
    "legend.frameon": False, "legend.fontsize": 8, "font.size": 9,
}  # fmt: skip


@dataclass(frozen=True)
class Line:
    """A line: its name in the legend, x and y, shape (N,), and its matplotlib properties."""

    name: str
    x: npt.NDArray[np.float64]
    y: npt.NDArray[np.float64]
    look: dict[str, Any]


@dataclass(frozen=True)
class Band:
    """The area between two lines: its name in the legend, x, low and high, shape (N,), and its colour."""

    name: str
    x: npt.NDArray[np.float64]
    low: npt.NDArray[np.float64]
    high: npt.NDArray[np.float64]
    colour: str


@dataclass(frozen=True)
class Panel:
    """Lines over one x axis.

    `shaded` are ranges of x drawn grey, such as those without data; `bands` lie behind the lines; `moments` are values
    of x marked with a vertical line, such as alarms; `y_range` limits the y axis, None shows everything.
    """

    title: str
    x_label: str
    y_label: str
    lines: Sequence[Line]
    shaded: Sequence[tuple[float, float]] = ()
    y_log: bool = False
    bands: Sequence[Band] = ()
    moments: Sequence[float] = ()
    y_range: tuple[float, float] | None = None


@dataclass(frozen=True)
class IntervalMark:
    """A value with the ends of its interval, None for an open one; `other` is the value it is compared with."""

    name: str
    value: float
    low: float | None
    high: float | None
    colour: str
    other: float | None = None


def line_panels(panels: Sequence[Panel], columns: int, size: tuple[float, float]) -> tuple[Axes, ...]:
    """Draws panels row by row, with one legend for all of them.

    Args:
        panels: Panels to draw.
        columns: Number of panels side by side.
        size: Width and height of a panel [inch].

    Returns:
        The matplotlib axes, row by row.
    """
    import matplotlib.pyplot as plt

    rows = -(-len(panels) // columns)
    with plt.rc_context(STYLE):
        figure, grid = plt.subplots(
            rows, columns, figsize=(size[0] * columns, size[1] * rows + 0.3), layout="constrained", squeeze=False
        )
        handles: dict[str, Any] = {}
        for axes, panel in zip(grid.flat, panels, strict=True):
            for low, high in panel.shaded:
                axes.axvspan(low, high, color="#888888", alpha=0.15, linewidth=0)
            for band in panel.bands:
                look = {"color": band.colour, "alpha": 0.2, "linewidth": 0}
                handles[band.name] = axes.fill_between(band.x, band.low, band.high, **look)
            for moment in panel.moments:
                handles["alarm"] = axes.axvline(moment, color="#c4232b", linewidth=1.2, linestyle=(0, (4, 2)))
            for line in panel.lines:
                handles[line.name] = axes.plot(line.x, line.y, **line.look)[0]
            axes.set(title=panel.title, xlabel=panel.x_label, ylabel=panel.y_label)
            axes.margins(x=0.02)
            if panel.y_range is not None:
                axes.set_ylim(*panel.y_range)
            if panel.y_log:
                axes.set_yscale("log")
        figure.legend(handles.values(), handles, loc="outside upper right", ncols=len(handles))
    return tuple(grid.flat)


def interval_panels(panels: Sequence[tuple[str, Sequence[IntervalMark]]], other: str) -> tuple[Axes, ...]:
    """Draws values with their intervals, one panel for each title, side by side.

    Args:
        panels: Title and values, drawn from top to bottom; at least two panels.
        other: Legend text of the hollow marks.

    Returns:
        The matplotlib axes, from left to right.
    """
    import matplotlib.pyplot as plt
    from matplotlib.lines import Line2D

    with plt.rc_context(STYLE):
        figure, grid = plt.subplots(1, len(panels), figsize=(3.2 * len(panels), 2.4), layout="constrained")
        for axes, (title, values) in zip(grid, panels, strict=True):
            known = [end for each in values for end in (each.value, each.low, each.high, each.other) if end is not None]
            margin = 0.08 * (max(known, default=1.0) - min(known, default=0.0)) or 1.0
            ends = min(known, default=0.0) - margin, max(known, default=1.0) + margin
            for row, each in enumerate(values):
                _draw_interval(axes, row, each, ends)
            axes.set_xlim(*ends)
            axes.set_ylim(len(values) - 0.5, -0.5)
            axes.set_yticks(range(len(values)), [each.name for each in values])
            axes.set_title(title)
        if any(each.other is not None for _, values in panels for each in values):
            handle = Line2D([], [], **OTHER_LOOK)
            figure.legend([handle], [other], loc="outside lower right")
    return tuple(grid)


def _draw_interval(axes: Axes, row: int, each: IntervalMark, ends: tuple[float, float]) -> None:
    """Draws one value; an open end is an arrow at the edge of the panel."""
    low, high = ends[0] if each.low is None else each.low, ends[1] if each.high is None else each.high
    axes.plot([low, high], [row, row], color=each.colour, linewidth=2.2, solid_capstyle="butt")
    axes.plot([each.value], [row], "o", color=each.colour, markersize=5)
    if each.other is not None:
        axes.plot([each.other], [row], **OTHER_LOOK)
    for end, place, marker in ((each.low, ends[0], "<"), (each.high, ends[1], ">")):
        if end is None:
            axes.plot([place], [row], marker, color=each.colour, markersize=6, clip_on=False)
