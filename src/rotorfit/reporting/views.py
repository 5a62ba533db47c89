"""From evidence to charts: plain named series, independent of how they are drawn.

A `Chart` has everything that a drawing needs: lines over one x axis, marks, levels, a sentence on how to read it and a
text alternative. The page, the studio and the figures for a paper draw the same charts.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from rotorfit.assessment.evidence import FlightMotion
from rotorfit.core.flight_data import LONGEST_GAP
from rotorfit.core.frames import AXES, POSE_UNITS, Array

DRAWN_RATE = 30.0
"""Rate of the drawn motion [1/s]: the local polynomials pass no frequency above a third of it."""

MOST_POINTS = 20_000
"""Number of points of a drawn line above which it is reduced to the extremes of its stretches."""

MODEL_LOOKS = 6
"""Number of models with a colour and a dash of their own."""

READING = {
    "velocity": "Every piece of the predicted line comes from data that end 0.5 to 1 s before it; from there on only "
    "the commands are known. Where it covers the measured line, the model can be trusted that far ahead.",
    "acceleration": "The paper's Figure 4: a = R(g u(t − delay) − b v) in world axes, the command smoothed by the lag "
    "where the law has one, against the second derivative of the measured pose. What remains between the lines is "
    "wind, noise, and what the model leaves out.",
}
"""How to read the charts of a flight."""


@dataclass(frozen=True)
class Line:
    """One line of a chart.

    Attributes:
        name: Name in the legend.
        role: `measured`, `model`, `paper`, `hold`, or `residual`; it determines the style.
        y: Values, shape (N,); NaN breaks the line.
    """

    name: str
    role: str
    y: Array


@dataclass(frozen=True)
class Area:
    """The area between two lines, such as a 95 % interval: its name and its ends, shape (N,); NaN breaks it."""

    name: str
    low: Array
    high: Array


@dataclass(frozen=True)
class Mark:
    """One marked point: its place and its text."""

    x: float
    y: float
    role: str
    text: str


@dataclass(frozen=True)
class Chart:
    """Everything that a drawing needs.

    Attributes:
        kind: `velocity`, `acceleration`, `profile`, `horizon_velocity`, `horizon_position`, `correlation`,
            or `timeline`.
        axis: `x`, `y`, `z` or `yaw`.
        title: Short title.
        x_label: Label of x, with its unit.
        y_label: Label of y, with its unit.
        x: Values of x, shared by the lines, shape (N,).
        lines: Lines, in the order of drawing.
        reading: One sentence on how to read it.
        summary: One sentence on what it shows, in figures; the text alternative.
        marks: Points besides the lines.
        levels: Horizontal lines, value to name.
        span: A marked range of x, such as an interval; an open end is infinite.
        y_range: Range of y to show; None for all.
        y_log: Whether y is drawn on a logarithmic scale; all its values are then positive or NaN.
        areas: Areas behind the lines.
        shaded: Shaded ranges of x.
        moments: Marked values of x, such as alarms.
    """

    kind: str
    axis: str
    title: str
    x_label: str
    y_label: str
    x: Array
    lines: tuple[Line, ...]
    reading: str
    summary: str
    marks: tuple[Mark, ...] = ()
    levels: tuple[tuple[float, str], ...] = ()
    span: tuple[float, float] | None = None
    y_range: tuple[float, float] | None = None
    y_log: bool = False
    areas: tuple[Area, ...] = ()
    shaded: tuple[tuple[float, float], ...] = ()
    moments: tuple[float, ...] = ()


@dataclass(frozen=True)
class ChartRow:
    """One row of a chart of rows.

    Attributes:
        name: Name at the left.
        dots: Role and value; None is not drawn.
        low: Lower end of the interval of the first dot; None if it is open or missing.
        high: Upper end of that interval.
        text: The row in figures.
    """

    name: str
    dots: tuple[tuple[str, float | None], ...]
    text: str
    low: float | None = None
    high: float | None = None


@dataclass(frozen=True)
class RowChart:
    """Values in rows.

    Attributes:
        title: Short title.
        x_label: Label of the values, with their unit.
        rows: Rows, from the top.
        reading: One sentence on how to read it.
        summary: One sentence on what it shows, in figures; the text alternative.
        x_log: Whether the values are drawn on a logarithmic scale; all are then positive.
        level: A vertical line and its name.
    """

    title: str
    x_label: str
    rows: tuple[ChartRow, ...]
    reading: str
    summary: str
    x_log: bool = False
    level: tuple[float, str] | None = None


@dataclass(frozen=True)
class FlightView:
    """Measured against modelled motion of one flight.

    Attributes:
        path: Path of its log.
        role: `training` or `validation`.
        duration: Time under commands [s].
        charts: Velocity and acceleration of the axes that the flight commands and the model knows; they share one x.
        missing: Axes that the flight commands but the model does not know.
        drawn: How the series were reduced for drawing, one sentence.
    """

    path: str
    role: str
    duration: float
    charts: tuple[Chart, ...]
    missing: tuple[str, ...]
    drawn: str


def flight_view(motion: FlightMotion, role: str, points: int = MOST_POINTS) -> FlightView:
    """Charts of measured against modelled velocity and acceleration of one flight.

    Args:
        motion: Motion of the flight.
        role: `training` or `validation`.
        points: Largest number of points of a line.
    """
    series = {
        **{("velocity", name): values for name, values in motion.velocity.items()},
        **{("acceleration", name): values for name, values in motion.acceleration.items()},
    }
    pick = [AXES.index(axis) for axis in motion.axes]
    time, values, drawn = _reduced(motion.time, np.hstack([v[:, pick] for v in series.values()]), points)
    drawn_series = dict(zip(series, np.split(values, len(series), axis=1), strict=True))
    charts = []
    for kind in ("velocity", "acceleration"):
        for j, axis in enumerate(motion.axes):
            drawn_lines = {name: y[:, j] for (what, name), y in drawn_series.items() if what == kind}
            whole_lines = {name: y[:, pick[j]] for (what, name), y in series.items() if what == kind}
            charts.append(_motion_chart(kind, axis, time, drawn_lines, whole_lines))
    missing = tuple(axis for axis in motion.moved if axis not in motion.axes)
    return FlightView(motion.path, role, motion.duration, tuple(charts), missing, drawn)


def look_of(number: int) -> str:
    """Role of the lines and dots of one of several models; the styles repeat after `MODEL_LOOKS`."""
    return f"model-{number % MODEL_LOOKS + 1}"


def overlaid(views: Sequence[Sequence[Chart]], names: Sequence[str]) -> tuple[Chart, ...]:
    """Charts of several models, overlaid: common lines once, and one line for each model.

    Args:
        views: The charts of each model; those of one kind and axis become one, without the paper's lines and bands.
        names: Names of the models; their lines have the roles of `look_of`.
    """
    places = dict.fromkeys((chart.kind, chart.axis) for charts in views for chart in charts)
    return tuple(
        _one_over_the_other(
            [(k, chart) for k, charts in enumerate(views) for chart in charts if (chart.kind, chart.axis) == place],
            names,
        )
        for place in places
    )


def _one_over_the_other(charts: Sequence[tuple[int, Chart]], names: Sequence[str]) -> Chart:
    """Overlays charts: lines with different x are interpolated to the union of all x, which does not change them."""
    first = charts[0][1]
    alike = all(chart.x.size == first.x.size and bool(np.all(chart.x == first.x)) for _, chart in charts)
    x = first.x if alike else np.unique(np.concatenate([chart.x for _, chart in charts]))
    lines = [line for line in first.lines if line.role in ("measured", "hold")] if alike else []
    for k, chart in charts:
        for line in chart.lines:
            if line.role == "model":
                y = line.y if alike else np.interp(x, chart.x, line.y, np.nan, np.nan)
                lines.append(Line(names[k], look_of(k), y))
    marks = [
        replace(mark, role=look_of(k), text=f"{names[k]}: {mark.text}")
        for k, chart in charts
        for mark in chart.marks
        if mark.role == "chosen"
    ]
    ranges = [chart.y_range for _, chart in charts if chart.y_range is not None]
    return replace(
        first,
        x=x,
        lines=tuple(lines),
        summary=" ".join(f"{names[k]}: {chart.summary}" for k, chart in charts),
        marks=tuple(marks),
        span=None,
        y_range=(min(low for low, _ in ranges), max(high for _, high in ranges)) if ranges else None,
    )


def _motion_chart(kind: str, axis: str, time: Array, drawn: Mapping[str, Array], whole: Mapping[str, Array]) -> Chart:
    """The chart of one axis of a flight; the figures of its summary come from the series before reduction."""
    unit = f"{POSE_UNITS[axis]}/s{'' if kind == 'velocity' else '²'}"
    frame = "" if axis in ("z", "yaw") else " (heading frame)" if kind == "velocity" else " (world)"
    modelled = "predicted" if kind == "velocity" else "modelled"
    names = {"measured": "measured", "model": modelled, "paper": "paper's prediction"}
    lines = tuple(Line(names[name], name, y) for name, y in drawn.items() if np.isfinite(y).any())
    told = f"{axis}: there is no {modelled} {kind} to compare with"
    if "model" in whole and np.isfinite(whole["model"] - whole["measured"]).any():
        error = whole["model"] - whole["measured"]
        spread = float(np.std(whole["measured"][np.isfinite(error)]))
        off = float(np.sqrt(np.nanmean(error**2)))
        told = f"{axis}: the {modelled} {kind} is off by {off:.3g} {unit} RMS, the measured varies by {spread:.3g}"
    return Chart(
        kind=kind,
        axis=axis,
        title=f"{axis} {kind}{frame}",
        x_label="time [s]",
        y_label=unit,
        x=time,
        lines=lines,
        reading=READING[kind],
        summary=f"{told}.",
    )


def _reduced(time: Array, values: Array, points: int) -> tuple[Array, Array, str]:
    """Stamps and columns for drawing, with a row of NaN in every hole, and one sentence on the reduction."""
    first = np.flatnonzero(np.diff(np.floor((time - time[0]) * DRAWN_RATE + 1e-6), prepend=-1.0) > 0)
    if first.size <= points:
        time, values = time[first], values[first]
        drawn = f"Drawn at up to {DRAWN_RATE:g} points a second: {time.size} points a line."
    else:
        time, values = extremes(time, values, points // 2)
        drawn = f"Long flight: each line is drawn by the extremes of {time.size // 2} stretches."
    holes = np.flatnonzero(np.diff(time) > LONGEST_GAP) + 1
    return np.insert(time, holes, time[holes - 1] + 1e-3), np.insert(values, holes, np.nan, axis=0), drawn


def extremes(time: Array, values: Array, stretches: int) -> tuple[Array, Array]:
    """Smallest and largest value of each column in each of equal stretches of time, in the order of their trend."""
    place = np.minimum(((time - time[0]) / (time[-1] - time[0]) * stretches).astype(int), stretches - 1)
    first = np.flatnonzero(np.diff(place, prepend=-1))
    last = np.append(first[1:], time.size) - 1
    low, high = np.fmin.reduceat(values, first), np.fmax.reduceat(values, first)
    rising = ~(values[last] < values[first])
    pairs = np.stack([np.where(rising, low, high), np.where(rising, high, low)], axis=1)
    stamps = np.stack([time[first], 0.5 * (time[first] + time[last])], axis=1)
    stamps[first == last, 1] += 1e-6
    return stamps.ravel(), pairs.reshape(-1, values.shape[1])
