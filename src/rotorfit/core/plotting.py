"""Figures of results by matplotlib, which is imported when the first one is drawn: lines over x, and intervals."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

from rotorfit.core.frames import Array

if TYPE_CHECKING:
    from matplotlib.axes import Axes

AXIS_COLOURS = {"x": "#0b57b7", "y": "#b4470b", "z": "#1a7f37", "yaw": "#6f42c1"}

PREDICTOR_LOOKS: dict[str, dict[str, Any]] = {
    "model": {"color": "#0b57b7", "linewidth": 1.6},
    "paper": {"color": "#b4470b", "linestyle": (0, (5, 2))},
    "hold": {"color": "#6f42c1", "linestyle": (0, (1, 1.5))},
}
"""Told apart without colour, too."""

STYLE: dict[Any, Any] = {
    "axes.grid": True, "axes.axisbelow": True, "axes.spines.top": False, "axes.spines.right": False,
    "axes.titlelocation": "left", "axes.titlesize": 10, "grid.color": "#e4e4e4", "grid.linewidth": 0.6,
    "legend.frameon": False, "legend.fontsize": 8, "font.size": 9,
}  # fmt: skip


@dataclass(frozen=True)
class Line:
    """A line: its name in the legend (none where empty), x and y, shape (N,), and what matplotlib is told of it."""

    name: str
    x: Array
    y: Array
    look: dict[str, Any]


@dataclass(frozen=True)
class Panel:
    """Lines over one x axis; `shaded` are the ranges of x where nothing is known."""

    title: str
    x_label: str
    y_label: str
    lines: Sequence[Line]
    shaded: Sequence[tuple[float, float]] = ()


@dataclass(frozen=True)
class IntervalMark:
    """A value with its ends, an open one None; `other` is what it is compared with."""

    name: str
    value: float
    low: float | None
    high: float | None
    colour: str
    other: float | None = None


def line_panels(panels: Sequence[Panel], columns: int, size: tuple[float, float]) -> tuple[Axes, ...]:
    """Draws panels row by row.

    Args:
        panels: What to draw.
        columns: Panels side by side.
        size: Width and height of a panel [inch].
    """
    rows = -(-len(panels) // columns)
    drawn = _axes(rows, columns, (size[0] * columns, size[1] * rows))
    for axes, panel in zip(drawn, panels, strict=True):
        for low, high in panel.shaded:
            axes.axvspan(low, high, color="#888888", alpha=0.15, linewidth=0)
        for line in panel.lines:
            axes.plot(line.x, line.y, label=line.name or None, **line.look)
        axes.set_title(panel.title)
        axes.set_xlabel(panel.x_label)
        axes.set_ylabel(panel.y_label)
        if any(line.name for line in panel.lines):
            axes.legend(loc="upper right", ncols=4, bbox_to_anchor=(1, 1.02), borderaxespad=0)
    return drawn


def interval_panels(panels: Sequence[tuple[str, Sequence[IntervalMark]]], other: str) -> tuple[Axes, ...]:
    """Draws values with their intervals, a panel for each title, side by side.

    Args:
        panels: Title, and the values from top to bottom.
        other: What the hollow marks are.
    """
    drawn = _axes(1, len(panels), (3.3 * len(panels), 2.4))
    for axes, (title, values) in zip(drawn, panels, strict=True):
        known = [end for each in values for end in (each.value, each.low, each.high, each.other) if end is not None]
        margin = 0.08 * (max(known) - min(known)) or 1.0
        left, right = min(known) - margin, max(known) + margin
        for row, each in enumerate(values):
            low, high = left if each.low is None else each.low, right if each.high is None else each.high
            axes.plot([low, high], [row, row], color=each.colour, linewidth=2.2, solid_capstyle="butt")
            axes.plot([each.value], [row], "o", color=each.colour, markersize=5)
            if each.other is not None:
                axes.plot([each.other], [row], "D", color="black", fillstyle="none", markersize=5)
            for end, place, marker in ((each.low, left, "<"), (each.high, right, ">")):
                if end is None:
                    axes.plot([place], [row], marker, color=each.colour, markersize=6, clip_on=False)
        axes.set_xlim(left, right)
        axes.set_ylim(len(values) - 0.5, -0.5)
        axes.set_yticks(range(len(values)), [each.name for each in values])
        axes.set_title(title)
    if any(each.other is not None for _, values in panels for each in values):
        drawn[0].plot([], [], "D", color="black", fillstyle="none", markersize=5, linestyle="none", label=other)
        drawn[0].figure.legend(loc="outside lower right")
    return drawn


def _axes(rows: int, columns: int, size: tuple[float, float]) -> tuple[Axes, ...]:
    """Axes of a new figure in the common style, row by row."""
    import matplotlib.pyplot as plt

    with plt.rc_context(STYLE):
        _, axes = plt.subplots(rows, columns, figsize=size, layout="constrained", squeeze=False)
    return tuple(axes.ravel())
