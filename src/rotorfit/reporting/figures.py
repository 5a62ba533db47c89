"""From views to static figures for a paper, each as PNG and PDF, in the sizes of a two-column page."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from io import BytesIO
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from rotorfit.assessment.evidence import Evidence, FlightMotion
from rotorfit.core.frames import AXES
from rotorfit.core.writing import write_whole
from rotorfit.reporting.charts import horizon_charts, profile_charts, residual_charts
from rotorfit.reporting.drawing import log_ticks
from rotorfit.reporting.views import Chart, flight_view

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

ONE_COLUMN, TWO_COLUMNS = 3.45, 7.1
"""Widths of figures [inch]: those of the two-column pages of most journals."""

STYLE: dict[Any, Any] = {
    "font.size": 8,
    "font.family": "sans-serif",
    "font.sans-serif": ["Arial", "Helvetica", "Liberation Sans", "DejaVu Sans"],
    "axes.labelsize": 8,
    "axes.titlesize": 8,
    "axes.linewidth": 0.6,
    "axes.grid": True,
    "axes.axisbelow": True,
    "axes.spines.top": False,
    "axes.spines.right": False,
    "grid.color": "#dddddd",
    "grid.linewidth": 0.4,
    "xtick.labelsize": 7,
    "ytick.labelsize": 7,
    "legend.fontsize": 7,
    "legend.frameon": False,
    "lines.linewidth": 0.9,
    "pdf.fonttype": 42,  # TrueType: journals require embedded fonts, not outlines
    "savefig.dpi": 300,
    "path.simplify": True,
}

LOOK: Mapping[str, Mapping[str, Any]] = {
    "measured": {"color": "#7a8593", "linewidth": 1.3},
    "model": {"color": "#0b57b7", "linewidth": 0.8},
    "paper": {"color": "#b4470b", "linewidth": 0.8, "linestyle": (0, (5, 2))},
    "hold": {"color": "#6f42c1", "linewidth": 0.9, "linestyle": (0, (1, 1.5))},
    "band": {"color": "#59636e", "linewidth": 0.5},
}
"""Role of a line to its style, which is distinct without colour too."""


def figures(evidence: Evidence, directory: Path) -> list[Path]:
    """Writes every figure that has content; see `write_figures`."""
    import matplotlib as mpl

    directory.mkdir(parents=True, exist_ok=True)
    motion = _widest(evidence.validation or evidence.training)
    horizons = horizon_charts(evidence.scores, evidence.case.validation.paired)
    content: dict[str, tuple[Callable[[Sequence[Chart]], Figure], Sequence[Chart]]] = {
        "acceleration": (_stacked, [chart for chart in motion if chart.kind == "acceleration"]),
        "velocity": (_stacked, [chart for chart in motion if chart.kind == "velocity"]),
        "horizon": (_in_a_row, horizons),
        "delay": (_in_a_row, profile_charts(evidence.case.model)),
        "residuals": (_in_a_row, _by_label(residual_charts(evidence.autocorrelation, evidence.command_correlation))),
    }
    written = []
    with mpl.rc_context(STYLE):
        for name, (draw, charts) in content.items():
            if charts:
                written += _saved(draw(charts), directory / name)
    return written


def _by_label(charts: Sequence[Chart]) -> list[Chart]:
    """Charts whose y labels distinguish the rows, in place of titles."""
    return [replace(chart, kind=f"{chart.kind} {chart.y_label}") for chart in charts]


def _widest(flights: Sequence[FlightMotion]) -> list[Chart]:
    """Charts of motion, each axis from the flight on which its measured velocity varies most."""
    chosen: dict[str, tuple[float, list[Chart]]] = {}
    for motion in flights:
        charts = flight_view(motion, "validation").charts
        for axis in {chart.axis for chart in charts}:
            mine = [chart for chart in charts if chart.axis == axis]
            measured = next(line.y for chart in mine if chart.kind == "velocity" for line in chart.lines)
            spread = float(np.nanstd(measured))
            if axis not in chosen or spread > chosen[axis][0]:
                chosen[axis] = (spread, mine)
    return [chart for axis in AXES if axis in chosen for chart in chosen[axis][1]]


def _saved(figure: Figure, stem: Path) -> list[Path]:
    """PNG and PDF, without the date, so that the same data give the same bytes."""
    png, pdf = stem.with_suffix(".png"), stem.with_suffix(".pdf")
    for path, dated in ((png, None), (pdf, {"CreationDate": None})):
        drawn = BytesIO()
        figure.savefig(drawn, format=path.suffix[1:], metadata=dated)
        write_whole(path, drawn.getvalue(), keep=False)
    return [png, pdf]


def _stacked(charts: Sequence[Chart]) -> Figure:
    """Charts one below the other, as in the paper's Figure 4: x, y, z, yaw."""
    from matplotlib.figure import Figure

    figure = Figure(figsize=(TWO_COLUMNS, 0.35 + 1.3 * len(charts)), layout="constrained")
    panels = figure.subplots(len(charts), 1, squeeze=False)[:, 0]
    for panel, chart in zip(panels, charts, strict=True):
        _lines(panel, chart)
        panel.set_ylabel(f"{chart.axis} [{chart.y_label}]")
        panel.set_xlim(float(chart.x[0]), float(chart.x[-1]))
    panels[-1].set_xlabel(charts[-1].x_label)
    panels[0].legend(loc="lower right", bbox_to_anchor=(1, 0.98), ncols=3, borderaxespad=0)
    return figure


def _in_a_row(charts: Sequence[Chart]) -> Figure:
    """Small charts side by side, one row for each kind."""
    from matplotlib.figure import Figure

    kinds = list(dict.fromkeys(chart.kind for chart in charts))
    columns = max(sum(chart.kind == kind for chart in charts) for kind in kinds)
    width = ONE_COLUMN if columns < 3 else TWO_COLUMNS
    figure = Figure(figsize=(width, 0.25 + 1.6 * len(kinds)), layout="constrained")
    panels = figure.subplots(len(kinds), columns, squeeze=False)
    for row, kind in zip(panels, kinds, strict=True):
        for panel, chart in zip(row, [chart for chart in charts if chart.kind == kind], strict=True):
            _lines(panel, chart)
            panel.set_title(chart.axis, loc="left", fontweight="bold")
            panel.set_xlabel(chart.x_label)
            panel.set_ylabel(chart.y_label)
    if kinds[0].startswith("horizon") or kinds[0] == "profile":
        figure.legend(*panels[0][0].get_legend_handles_labels(), loc="outside upper right", ncols=3)
    return figure


def profile_range(chart: Chart) -> tuple[float, float]:
    """Range of x in which a profile, its interval and its marks lie within the range of y, a fifth wider each way."""
    grid = np.linspace(chart.x[0], chart.x[-1], 4000)
    low, high = chart.y_range or (-np.inf, np.inf)
    seen = grid[np.interp(grid, chart.x, chart.lines[0].y) >= low]
    marks = [mark.x for mark in chart.marks if low <= mark.y <= high]
    ends = np.array([*seen[[0, -1]], *marks, *np.clip(chart.span or marks, chart.x[0], chart.x[-1])])
    margin = 0.2 * float(np.ptp(ends))
    return float(ends.min()) - margin, float(ends.max()) + margin


def _lines(panel: Axes, chart: Chart) -> None:
    """Lines, levels, marks and the marked range of one chart."""
    if chart.span is not None:
        low, high = np.clip(chart.span, chart.x[0], chart.x[-1])
        panel.axvspan(float(low), float(high), color="#0b57b7", alpha=0.12, linewidth=0, label="95 %, the vehicle")
    for value, _ in chart.levels:
        panel.axhline(value, color="black", linewidth=0.6, linestyle=(0, (4, 3)))
    for line in chart.lines:
        if line.role == "band":
            panel.plot(chart.x, line.y, **LOOK["band"])
        elif chart.kind.startswith("correlation"):
            panel.vlines(chart.x, 0, line.y, color=LOOK["model"]["color"], linewidth=0.8)
        else:
            marker = "o" if chart.kind.startswith("horizon") else ""
            panel.plot(chart.x, line.y, label=line.name, marker=marker, markersize=2.5, **LOOK[line.role])
    for mark in chart.marks:
        colour = LOOK["model" if mark.role == "chosen" else "paper"]["color"]
        panel.plot([mark.x], [mark.y], "o", color=colour, markersize=3)
    if chart.y_range is not None:
        panel.set_ylim(*chart.y_range)
    if chart.kind == "profile":
        panel.set_xlim(*profile_range(chart))
    if chart.kind.startswith("horizon"):
        panel.set_xlim(left=0)
    if chart.y_log:
        panel.set_yscale("log")
        places, texts = zip(*log_ticks(*panel.get_ylim(), 6), strict=True)
        panel.set_yticks(places, texts)
        panel.minorticks_off()
