"""From a Track to one self-contained page: final state, estimates over time, changes, regimes, and next steps."""

import math
import shlex
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from rotorfit.core.flight_data import Flight
from rotorfit.core.frames import AXES, POSE_UNITS
from rotorfit.core.model import COEFFICIENTS, Interval, Model
from rotorfit.core.tracked import QUANTITIES, Air, Alarm, Knowledge, Regime, Track, TrackedAxis
from rotorfit.reporting.document import Heading, document
from rotorfit.reporting.drawing import draw_chart
from rotorfit.reporting.panels import FlightPanels, Panel, packed, series
from rotorfit.reporting.views import Area, Chart, FlightView, Line
from rotorfit.reporting.words import and_list, rounded, sentences, term_of
from rotorfit.tracking.flight_so_far import UNRECORDED

SHOWN = ("input", "damping", "delay", "lag", "wind")
"""Quantities with a chart, if they are told at any time."""

READING = (
    "The line is the estimate, the band its 95 % interval for the vehicle as known then; where the line ends nothing "
    "was told. Every second regime is grey, red lines are alarms."
)

MOST_STATES = 1200
"""Largest number of points of a line; for longer flights, only every second, third ... state is drawn."""

COLOURS: Mapping[Knowledge, str] = {
    "known": "green",
    "holding": "yellow",
    "not_identifiable": "yellow",
    "learning": "grey",
    "not_excited": "grey",
}


@dataclass(frozen=True)
class AxisNow:
    """One axis at the end: name, colour, state, and wind with its interval."""

    axis: str
    colour: str
    state: str
    wind: str


@dataclass(frozen=True)
class Raised:
    """An alarm in words: time and cause, time of the change, what changed, confidence, and reason."""

    title: str
    axes: str
    since: str
    changes: tuple[str, ...]
    sure: str
    why: str


def timeline_page(track: Track, flight: Flight, files: Sequence[Path | None] = (), again: Sequence[str] = ()) -> str:
    """The whole page.

    Args:
        track: The track.
        flight: The flight as recorded.
        files: Model file of each regime, or None.
        again: Log and options of `rotorfit track` for this flight; default: the flight's path alone.
    """
    last = track.states[-1]
    panels = _panels(track)
    shared = {
        "several": False,
        "cases": (),
        "names": (),
        "roles": (),
        "read": READING,
    }
    known = [_now(name, last.axes[name]) for name in track.axes if name in last.axes]
    sections: dict[str, tuple[str, Mapping[str, Any]]] = {
        "now": (
            "Now",
            {
                "headline": _headline(track),
                "states": known,
                "rows": _rows(last.axes),
                "air": _air(last.air),
                "remarks": (*track.faults, *track.laws_at_end, *track.drifts),
            },
        ),
        "time": ("Over time", {"number": panels.number, "axes": _by_axis(panels)}),
        "alarms": (
            "Alarms",
            {"alarms": [raised(one) for one in track.alarms], "watch": track.watch, "drifts": track.drifts},
        ),
        "regimes": ("Regimes", {"regimes": _regimes(track.regimes, files), "several_regimes": len(track.regimes) > 1}),
        "on": (
            "How to go on",
            {"commands": _commands(track, flight, files, again or (flight.path,)), "notes": flight.notes},
        ),
    }
    heading = Heading(
        title="Tracked flight",
        kind="tracked flight",
        name=flight.card.name,
        origins=(("", f"{flight.path}: {last.time:.0f} s, tracked second by second from past data only."),),
        first="what is known now",
    )
    parts = {anchor: (title, f"timeline/{anchor}.html.j2", content) for anchor, (title, content) in sections.items()}
    return document(heading, parts, [_series(panels)], shared)


# What is known now


def _headline(track: Track) -> str:
    """One sentence: which axes are known, and which alarms were raised."""
    axes = track.states[-1].axes
    told = [name for name in track.axes if name in axes and axes[name].knowledge in ("known", "holding")]
    rest = [name for name in track.axes if name not in told]
    if not track.axes:
        first = "No command moved the vehicle"
    elif not told:
        first = f"{and_list(rest)} {'is' if len(rest) == 1 else 'are'} not known yet"
    else:
        first = f"{and_list(told)} {'is' if len(told) == 1 else 'are'} known"
        first += f", {and_list(rest)} not" if rest else ""
    alarms = track.alarms
    if not alarms:
        return f"{first}; no alarm."
    if len(alarms) == 1:
        return f"{first}; one alarm, at {alarms[0].raised:.2f} s: {alarms[0].named}."
    return f"{first}; {len(alarms)} alarms, the last at {alarms[-1].raised:.2f} s: {alarms[-1].named}."


def _now(name: str, axis: TrackedAxis) -> AxisNow:
    wind = ""
    if axis.wind is not None:
        wind = f"{_value(axis.wind, axis.wind_ci95)} {unit_of('wind', name)} ({_interval(axis.wind_ci95, axis.wind)})"
    return AxisNow(name, COLOURS[axis.knowledge], axis.state, wind)


def _air(air: Air | None) -> str:
    """The mean wind in words; empty if it is unknown."""
    if air is None:
        return ""
    if not air.significant:
        return f"Mean wind of at most the last 40 s: below {_value(air.speed_ci95[1], air.speed_ci95)} m/s."
    speed = f"{_value(air.speed, air.speed_ci95)} m/s ({_interval(air.speed_ci95, air.speed)})"
    ends = tuple(math.degrees(end) for end in air.direction_ci95)
    return (
        (
            f"Mean wind of at most the last 40 s: {speed} towards {math.degrees(air.direction):.0f}° "
            f"({ends[0]:.0f} to {ends[1]:.0f}°) from the world's x, counter-clockwise."
        )
        .replace("-", "−")
        .replace("counter−", "counter-")
    )


def _rows(axes: Mapping[str, TrackedAxis]) -> list[list[tuple[str, ...]]]:
    """The rows of the table for each axis: quantity, its term, value, unit, and both intervals."""
    out: list[list[tuple[str, ...]]] = []
    for name, axis in axes.items():
        rows: list[tuple[str, ...]] = [
            (
                name, what.replace("_", " "), term_of(what), _value(value, axis.ci95.get(what)), unit_of(what, name),
                _interval(axis.ci95.get(what), value), _interval(axis.ci95_flight.get(what), value),
            )
            for what in QUANTITIES
            if (value := axis.values.get(what)) is not None
        ]  # fmt: skip
        out += [rows] if rows else []
    return out


def unit_of(what: str, axis: str) -> str:
    """The unit of a quantity; those of input and steady gain are per unit of the command."""
    length = POSE_UNITS[axis]
    units = {"input": f"{length}/s² per command", "damping": "1/s", "steady_gain": f"{length}/s per command"}
    return f"{length}/s²" if what == "wind" else units.get(what, "s")


def _value(value: float, ends: Interval | None) -> str:
    return rounded(value, _width(ends))


def _width(ends: Interval | None) -> float | None:
    """About the standard error."""
    if ends is None or None in ends:
        return None
    low, high = ends
    assert low is not None
    assert high is not None
    return (high - low) / 4 or None


def _interval(ends: Interval | None, value: float) -> str:
    if ends is None or ends == (None, None):
        return "open"
    scale = _width(ends) or abs(value) / 10
    return " to ".join("open" if end is None else rounded(end, scale) for end in ends)


# Over time


def _panels(track: Track) -> FlightPanels:
    """The charts of all axes, with their numbers."""
    panels: list[Panel] = []
    for axis in track.axes:
        for what in SHOWN:
            if (chart := _chart(track, axis, what)) is not None:
                panels.append(
                    Panel(chart, replace(draw_chart(chart, 330, 190), y_label=""), len(panels))
                )  # in its title
    view = FlightView("", "tracked", track.states[-1].time, (), (), "")
    return FlightPanels(0, view, tuple(panels), (), True)


def _by_axis(panels: FlightPanels) -> list[tuple[str, list[Panel]]]:
    """Axis to its charts, in the order of the axes."""
    out: dict[str, list[Panel]] = {}
    for panel in panels.panels:
        assert isinstance(panel.chart, Chart)
        out.setdefault(panel.chart.axis, []).append(panel)
    return list(out.items())


def _chart(track: Track, axis: str, what: str) -> Chart | None:
    """One quantity of one axis over time; None if it was never told."""
    line = track.timeline(axis, what)
    shown = line.shown
    if shown is None:
        return None
    keep = slice(None, None, math.ceil(line.time.size / MOST_STATES))
    told = np.flatnonzero(np.isfinite(line.value))
    name, unit = what if what == "wind" else term_of(what), unit_of(what, axis)
    first, last = int(told[0]), int(told[-1])
    value = f"{line.value[last]:.3g} {unit}".replace("-", "−")
    summary = f"From {line.time[first]:.0f} s on; at {line.time[last]:.0f} s {value}."
    if first == last:
        summary = f"Only at {line.time[last]:.0f} s: {value}."
    return Chart(
        kind="timeline",
        axis=axis,
        title=f"{axis}: {name}",
        x_label="time [s]",
        y_label=unit,
        x=line.time[keep],
        lines=(Line(name, "model", line.value[keep]),),
        reading="",
        summary=summary,
        y_range=shown,
        areas=(Area("95 % interval", line.low[keep], line.high[keep]),),
        shaded=tuple((one.start, one.end) for one in track.regimes[1::2]),
        moments=tuple(alarm.raised for alarm in track.alarms),
    )


def _series(panels: FlightPanels) -> dict[str, Any]:
    """The data for zooming the charts; the ends of the bands are lines of their own."""
    out = series(panels)
    for panel, chart in zip(panels.panels, out["charts"], strict=True):
        shown = panel.chart
        assert isinstance(shown, Chart)
        for area in shown.areas:
            count = len(chart["lines"])
            chart["lines"] += [
                {"name": "95 % from", "role": "end", "y": packed(area.low)},
                {"name": "to", "role": "end", "y": packed(area.high)},
            ]
            chart["areas"] = [[count + 2, count + 1]]
        chart |= {"range": shown.y_range, "apart": shown.shaded, "moments": shown.moments}
    return out


# What changed


def raised(alarm: Alarm) -> Raised:
    """An alarm in words."""
    return Raised(
        f"{alarm.raised:.2f} s: {alarm.named}",
        and_list(alarm.axes),
        f"{alarm.since[0]:.1f} to {alarm.since[1]:.1f} s",
        _changes(alarm),
        f"{_share(alarm.confidence)} of the evidence; without a change as much is seen with a chance of "
        f"{alarm.p_value:.1g} a look",
        sentences([alarm.why])[0],
    )


def _share(share: float) -> str:
    return f"{100 * share:.0f} %" if share < 0.995 else "more than 99 %"


def _changes(alarm: Alarm) -> tuple[str, ...]:
    """What changed and by how much, with its interval; axes with equal changes are combined."""
    alike: dict[tuple[str, str], list[str]] = {}
    for name in alarm.change:
        axis, what = name.split(".")
        alike.setdefault((what, _by(alarm, name)), []).append(axis)
    return tuple(f"{term_of(what)} of {and_list(axes)} {by}" for (what, by), axes in alike.items())


def _by(alarm: Alarm, name: str) -> str:
    low, high = alarm.change[name]
    if alarm.is_ratio(name):
        return f"{low:.2f} to {high:.2f} times what it was"
    unit = alarm.unit(name)
    factor, unit = (1e3, "ms") if unit == "s" else (1.0, unit.replace("^2", "²"))
    ends = " to ".join(f"{factor * end:+.2g}".replace("-", "−") for end in (low, high))
    return f"by {ends} {unit}".rstrip()


# The regimes and how to go on


def _regimes(regimes: Sequence[Regime], files: Sequence[Path | None]) -> list[dict[str, Any]]:
    """Time, cause, model file and coefficients of each regime."""
    known = [*files, *[None] * (len(regimes) - len(files))]
    return [
        {
            "number": number,
            "span": f"{one.start:.1f} to {one.end:.1f} s",
            "begun": one.begun_by.named if one.begun_by else "as it began",
            "file": str(path) if path else "",
            "cells": _cells(one.model),
            "forgotten": one.forgotten,
        }
        for number, (one, path) in enumerate(zip(regimes, known, strict=True), 1)
    ]


def _cells(model: Model | None) -> list[list[str]]:
    """Rows of axis, law, coefficients and what compares between laws; none for a regime that was too short."""
    if model is None:
        return []
    out = []
    for name in AXES:
        axis = model.axes.get(name)
        if axis and axis.predictor:
            values = {what: (getattr(axis, what), axis.ci95.get(what)) for what in COEFFICIENTS}
            for what in ("steady_gain", "total_lag"):
                known = axis.combinations.get(what)
                values[what] = (known.value, known.ci95) if known else (None, None)
            out.append([name, axis.structure, *(_with_interval(value, ends) for value, ends in values.values())])
    return out


def _with_interval(value: float | None, ends: Interval | None) -> str:
    return "—" if value is None else f"{_value(value, ends)} ({_interval(ends, value)})"


def _commands(track: Track, flight: Flight, files: Sequence[Path | None], again: Sequence[str]) -> list[str]:
    """Lines to type, using the model of the last regime that has one."""
    lines = []
    last = next((path for path in reversed(files) if path), None)
    if last is None and flight.path == UNRECORDED:
        return ["# neither model nor recording was written: next time add -o model.json or --record flight.mcap"]
    if last is None:
        lines.append(shlex.join(["rotorfit", "track", *again, "-o", "model.json"]))
        numbered = [n for n, one in enumerate(track.regimes, 1) if one.model]
        if not numbered:
            return []
        last = Path("model.json" if len(track.regimes) == 1 else f"model-{numbered[-1]}.json")
    model = shlex.quote(str(last))
    plan = f"rotorfit plan --after {model} --room 6x4x3 -o plan.toml"
    return [
        *lines,
        f"rotorfit validate {model} NEXT-FLIGHT.csv",
        f"rotorfit tune {model} -o gains.toml",
        f"rotorfit export {model} --to numpy -o model.py",
        *[plan] * (flight.card.command_frame == "heading"),  # no plan commands the world frame
    ]
