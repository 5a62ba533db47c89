"""From Chart to Drawing: coordinates, ticks and paths of a small vector picture, for a template."""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from rotorfit.core.frames import Array, Indices
from rotorfit.reporting.views import Chart, RowChart

LETTER = 7.0
"""Width of a letter of a tick's text, so that the title beside the ticks does not cross them."""

FINENESS = 4
"""Steps of a path's integer coordinates per unit of the picture: keeps paths short."""

DASH = 2 * FINENESS
"""Half the length of a lone point [steps]: a line to nowhere shows nothing."""

COLUMNS = 250
"""Number of stretches of a long line, each drawn by its extremes."""

MIN_SPACE = 18
"""Least distance of two horizons that both get a tick label [units of the picture]."""

FEW_HORIZONS = 5
"""Largest number of horizons that each get a tick label; more are drawn as a curve with regular ticks."""


@dataclass(frozen=True)
class Tick:
    """A tick: its place along an axis [units of the picture] and its label."""

    at: float
    text: str


@dataclass(frozen=True)
class Dot:
    """A marked point with its text."""

    x: float
    y: float
    role: str
    text: str


@dataclass(frozen=True)
class Stop:
    """A place where pointer and arrow keys show figures: along the x axis, or along y for a chart of rows."""

    at: float
    text: str


@dataclass(frozen=True)
class Drawing:
    """A picture in its own units, y downwards; paths and dots are relative to the frame's upper left corner.

    Attributes:
        width: Width of the picture.
        height: Height of the picture.
        left: Left edge of the frame.
        top: Top edge of the frame.
        inner_width: Width of the frame.
        inner_height: Height of the frame.
        fineness: Integer steps of the paths' coordinates per unit.
        paths: Role and path, in the order of drawing.
        dots: Points.
        levels: Horizontal lines.
        shade: Left end and width of the marked range; None for none.
        x_ticks: Ticks along the bottom.
        y_ticks: Ticks along the left.
        x_label: Label of x, with its unit.
        y_label: Label of y, with its unit.
        stops: Stops, in the order of their places.
        along: The axis of the stops.
        areas: Filled paths, behind all others.
        shaded: Left ends and widths of the shaded ranges.
        moments: Vertical lines.
    """

    width: int
    height: int
    left: int
    top: int
    inner_width: int
    inner_height: int
    fineness: int
    paths: tuple[tuple[str, str], ...]
    dots: tuple[Dot, ...]
    levels: tuple[Tick, ...]
    shade: tuple[float, float] | None
    x_ticks: tuple[Tick, ...]
    y_ticks: tuple[Tick, ...]
    x_label: str
    y_label: str
    stops: tuple[Stop, ...] = ()
    along: str = "x"
    areas: tuple[str, ...] = ()
    shaded: tuple[tuple[float, float], ...] = ()
    moments: tuple[float, ...] = ()


def draw_chart(chart: Chart, width: int, height: int, columns: int = COLUMNS) -> Drawing:
    """The picture of a chart.

    Args:
        chart: What to draw.
        width: Width of the picture, in its own units of about a pixel.
        height: Height of the picture.
        columns: Number of stretches of a long line, each drawn by its extremes.
    """
    x_range, y_range = _x_range(chart), _y_range(chart)
    top, inner_height = 8, height - 8 - 38
    y_ticks = (log_ticks if chart.y_log else ticks)(*y_range, inner_height // 32)
    left = max(46, 24 + round(LETTER * max((len(text) for _, text in y_ticks), default=0)))
    inner_width = width - left - 10

    def place_x(x: Array | float) -> Array:
        return np.asarray((np.asarray(x) - x_range[0]) / (x_range[1] - x_range[0]) * inner_width)

    def place_y(y: Array | float) -> Array:
        y, (low, high) = (np.log10(y), np.log10(y_range)) if chart.y_log else (np.asarray(y), y_range)
        return np.asarray((high - y) / (high - low) * inner_height)

    x_ticks = ticks(*x_range, inner_width // 60)
    if chart.kind.startswith("horizon") and chart.x.size <= FEW_HORIZONS:
        x_ticks = [
            (float(x), f"{x:g}") for x in chart.x if x == chart.x[0] or place_x(x) - place_x(chart.x[0]) > MIN_SPACE
        ]
    paths = tuple(
        (line.role, _bars(place_x(chart.x), place_y(line.y), float(place_y(0.0))))
        if chart.kind == "correlation" and line.role != "band"
        else (line.role, _path(place_x(chart.x), place_y(line.y), inner_height, columns))
        for line in chart.lines
    )
    dots = [
        Dot(
            float(place_x(mark.x)),
            float(np.clip(place_y(mark.y), 4, inner_height - 4)),
            mark.role if y_range[0] <= mark.y <= y_range[1] else f"{mark.role} beyond",
            mark.text,
        )
        for mark in chart.marks
    ]
    if chart.kind.startswith("horizon"):
        dots += [
            Dot(float(place_x(x)), float(place_y(y)), line.role, f"{line.name}, {x:g} s: {y:.3g} {_unit(chart)}")
            for line in chart.lines
            for x, y in zip(chart.x, line.y, strict=True)
            if np.isfinite(y) and line.role != "band"
        ]
    shade = None
    if chart.span is not None:
        ends = np.clip(place_x(np.clip(np.array(chart.span), *x_range)), 0, inner_width)
        shade = (float(ends[0]), float(ends[1] - ends[0]))
    shaded = [np.clip(place_x(np.clip(np.array(each), *x_range)), 0, inner_width) for each in chart.shaded]
    return Drawing(
        width, height, left, top, inner_width, inner_height, FINENESS, paths, tuple(dots),
        areas=tuple(
            _filled(place_x(chart.x), place_y(area.low), place_y(area.high), inner_height) for area in chart.areas
        ),
        shaded=tuple((float(low), float(high - low)) for low, high in shaded),
        moments=tuple(float(place_x(moment)) for moment in chart.moments),
        levels=tuple(Tick(float(place_y(value)), text) for value, text in chart.levels),
        shade=shade,
        x_ticks=tuple(Tick(float(place_x(value)), text) for value, text in x_ticks),
        y_ticks=tuple(Tick(float(place_y(value)), text) for value, text in y_ticks),
        x_label=chart.x_label,
        y_label=chart.y_label,
        stops=() if chart.kind in ("velocity", "acceleration") else _stops(chart, place_x),
    )  # fmt: skip


def drawn_rows(chart: RowChart, width: int) -> Drawing:
    """The picture of a chart of rows.

    Args:
        chart: What to draw.
        width: Width of the picture, in its own units of about a pixel.
    """
    left, top, row = min(170, 18 + round(7.0 * max((len(each.name) for each in chart.rows), default=0))), 4, 24
    inner_width, inner_height = width - left - 14, row * len(chart.rows)
    values = [value for each in chart.rows for _, value in each.dots if value is not None]
    values += [end for each in chart.rows for end in (each.low, each.high) if end is not None]
    values += [chart.level[0]] if chart.level else []
    low, high = (min(values), max(values)) if values else (0.5, 2.0)
    if chart.x_log:
        low, high = low / 1.3, high * 1.3
    else:
        margin = 0.06 * (high - low) or 0.1 * abs(high) or 1.0
        low, high = low - margin, high + margin

    def place(x: float) -> float:
        at = np.log(x / low) / np.log(high / low) if chart.x_log else (x - low) / (high - low)
        return float(np.clip(at, 0, 1)) * inner_width

    paths, dots, middles = [], [], [row * (k + 0.5) for k in range(len(chart.rows))]
    for each, y in zip(chart.rows, middles, strict=True):
        known = [(role, value) for role, value in each.dots if value is not None]
        if each.low is not None or each.high is not None:
            ends = (0 if each.low is None else place(each.low), inner_width if each.high is None else place(each.high))
            a, b, at = (round(FINENESS * value) for value in (*ends, y))
            paths.append((f"interval {each.dots[0][0]}", f"M{a} {at}H{b}"))
        dots += [Dot(place(value), y, role, each.text) for role, value in known]
    if chart.level:
        paths.insert(0, ("mark", f"M{round(FINENESS * place(chart.level[0]))} 0v{FINENESS * inner_height}"))
    x_ticks = (log_ticks if chart.x_log else ticks)(low, high, max(2, inner_width // 60))
    return Drawing(
        width, top + inner_height + 38, left, top, inner_width, inner_height, FINENESS, tuple(paths), tuple(dots),
        levels=(),
        shade=None,
        x_ticks=tuple(Tick(place(value), text) for value, text in x_ticks),
        y_ticks=tuple(Tick(y, each.name) for each, y in zip(chart.rows, middles, strict=True)),
        x_label=chart.x_label,
        y_label="",
        stops=tuple(Stop(y, each.text) for each, y in zip(chart.rows, middles, strict=True)),
        along="y",
    )  # fmt: skip


def _stops(chart: Chart, place: Callable[[Array | float], Array]) -> tuple[Stop, ...]:
    """The values of the lines at each x."""
    name, _, unit = chart.x_label.partition(" [")
    unit = unit.rstrip("]")
    shown = [line for line in chart.lines if line.role != "band"]
    areas = [(area.name, area.low, area.high) for area in chart.areas]
    band = next((line.y for line in chart.lines if line.role == "band"), None) if chart.kind == "correlation" else None
    stops = []
    for i, x in enumerate(chart.x):
        parts = [f"{line.name} {line.y[i]:.3g}" for line in shown if np.isfinite(line.y[i])]
        if len(shown) == 1:
            parts = [part.removeprefix(f"{shown[0].name} ") for part in parts]
        limit = "" if band is None or not np.isfinite(band[i]) else f", 95 % band ±{band[i]:.2g}"
        limit += "".join(f", {n} {_end(low[i])} to {_end(high[i])}" for n, low, high in areas)
        if parts:
            at = round(float(x), 9) + 0.0  # a grid of delays comes near 0 only, and a zero may be negative
            text = f"{name} {at:.3g} {unit}: {', '.join(parts)} {_unit(chart) if '[' in chart.y_label else ''}".rstrip()
            stops.append(Stop(float(place(x)), f"{text}{limit}".replace(" -", " −")))
    return tuple(stops)


def _end(value: float) -> str:
    return f"{value:.3g}" if np.isfinite(value) else "open"


def _unit(chart: Chart) -> str:
    return chart.y_label[chart.y_label.find("[") + 1 : chart.y_label.find("]")]


def _x_range(chart: Chart) -> tuple[float, float]:
    low, high = float(np.min(chart.x)), float(np.max(chart.x))
    if chart.kind in ("correlation", "horizon_velocity", "horizon_position"):
        low = 0.0
    pad = 0.03 * (high - low) if chart.kind not in ("velocity", "acceleration") else 0.0
    return (low, high + pad) if high > low else (low - 1, high + 1)


def _y_range(chart: Chart) -> tuple[float, float]:
    """The range of y: that of the chart, else all finite values and levels with a margin."""
    if chart.y_range is not None:
        return chart.y_range
    values = np.concatenate([np.array([level for level, _ in chart.levels]), *(line.y for line in chart.lines)])
    values = np.append(values[np.isfinite(values)], [0.0] * (chart.kind == "correlation"))  # bars begin at 0
    low, high = (float(values.min()), float(values.max())) if values.size else (0.0, 1.0)
    if chart.y_log:
        return 0.7 * low, 1.4 * high
    margin = 0.06 * (high - low) or 0.5 * abs(high) or 1.0
    return low - margin, high + margin


def _path(x: Array, y: Array, height: float, columns: int = COLUMNS) -> str:
    """Relative path in integer steps, broken at NaN; long lines are reduced to their peaks, lone points are dashes."""
    if x.size > 2 * columns:
        kept = peaks(y, columns)
        x, y = x[kept], y[kept]
    y = np.clip(y, -height, 2 * height)
    finite = np.isfinite(y)
    points = np.round(np.stack([x, np.where(finite, y, 0)], axis=1) * FINENESS).astype(int)
    parts, last, here = [], np.zeros(2, int), False
    for point, good, goes_on in zip(points, finite, [*finite[1:], False], strict=True):
        if good:
            half = DASH * (not here and not goes_on)
            step = point - last
            parts.append(f"{'l' if here else 'm'}{step[0] - half} {step[1]}" + f"l{2 * half} 0" * bool(half))
            last = point + np.array([half, 0])
        here = bool(good)
    return "".join(parts).replace(" -", "-")


def peaks(y: Array, stretches: int) -> Indices:
    """Indices of the minimum and maximum of a line in each of equal stretches, of its ends, and of the starts of holes.

    Args:
        y: Values, shape (N,); NaN in holes.
        stretches: Number of stretches.
    """
    place = np.arange(y.size) * stretches // y.size
    order, known = np.lexsort((y, place)), np.isfinite(y)
    order = order[known[order]]
    ends = np.flatnonzero(np.diff(place[order], prepend=-1, append=-1))
    holes = np.flatnonzero(~known & np.concatenate([[True], known[:-1]]))
    return np.unique(np.concatenate([order[ends[:-1]], order[ends[1:] - 1], holes, [0, y.size - 1]]).astype(np.intp))


def _filled(x: Array, low: Array, high: Array, height: float) -> str:
    """Closed paths between two lines, one for each run in which both are finite."""
    known = np.isfinite(low) & np.isfinite(high)
    ends = np.flatnonzero(np.diff(np.concatenate([[False], known, [False]]).astype(int)))
    out = []
    for begin, end in zip(ends[::2], ends[1::2], strict=True):
        there = np.stack([x[begin:end], np.clip(high[begin:end], -height, 2 * height)], axis=1)
        back = np.stack([x[begin:end], np.clip(low[begin:end], -height, 2 * height)], axis=1)[::-1]
        points = np.round(np.concatenate([there, back]) * FINENESS).astype(int)
        steps = np.diff(points, axis=0)
        out.append(f"M{points[0, 0]} {points[0, 1]}" + "".join(f"l{a} {b}" for a, b in steps) + "z")
    return "".join(out).replace(" -", "-")


def _bars(x: Array, y: Array, zero: float) -> str:
    """One vertical stroke for each value."""
    fine = [np.round(np.asarray(part) * FINENESS).astype(int) for part in (x, y, zero)]
    return "".join(f"M{a} {fine[2]}V{b}" for a, b in zip(fine[0], fine[1], strict=True))


def ticks(low: float, high: float, most: int) -> list[tuple[float, str]]:
    """Round values between two ends, at steps of 1, 2 or 5, with their text."""
    raw = (high - low) / max(most, 1)
    power = 10.0 ** np.floor(np.log10(raw))
    step = power * min((m for m in (1.0, 2.0, 5.0, 10.0) if m * power >= raw * (1 - 1e-9)), default=10.0)
    values = np.arange(np.ceil(low / step - 1e-9), np.floor(high / step + 1e-9) + 1) * step
    digits = max(0, int(-np.floor(np.log10(step) + 1e-9)))
    return [
        (float(v), f"{v + 0.0:.{digits}f}".replace("-", "−")) for v in np.where(np.abs(values) < step / 2, 0.0, values)
    ]


def log_ticks(low: float, high: float, most: int) -> list[tuple[float, str]]:
    """1, 2 and 5 times the powers of ten between two positive ends, or the powers alone if those are too many."""
    powers = 10.0 ** np.arange(np.floor(np.log10(low)), np.ceil(np.log10(high)) + 1)
    for factors in ((1.0, 2.0, 5.0), (1.0, 3.0), (1.0,)):
        values = [f * power for power in powers for f in factors if low <= f * power <= high]
        if len(values) <= most + 1:
            break
    return [(float(value), f"{value:.4g}") for value in values]
