"""Terminal output of tracking: what is new, second by second, and a table at the end."""

import math
import re
from collections.abc import Iterator, Mapping
from typing import Any

from rich.console import RenderableType
from rich.text import Text

from rotorfit.app.terminal.tables import View, bullets, indented, table, title
from rotorfit.core.display import interval_text, number_text
from rotorfit.core.frames import POSE_UNITS
from rotorfit.core.tracked import QUANTITIES, TIMES, Air, Alarm, Track, Tracked, TrackedAxis, other_law

UNITS = {
    "input": "{}/s^2", "damping": "1/s", "delay": "s", "lag": "s", "zero": "s", "steady_gain": "{}/s", "total_lag": "s",
}  # fmt: skip
"""Quantity to its unit, with `{}` for that of the axis' pose; input and steady gain are per command of 1."""

SHOWN_AT_ONCE = ("known", "not_identifiable")
"""States in which numbers are shown at once; in other states only if they are those of an earlier model."""


def news(before: Tracked | None, state: Tracked) -> Iterator[RenderableType]:
    """Alarms, the axes whose knowledge or law has changed since a second ago, and where watch and wind begin."""
    for alarm in state.alarms:
        yield from alarm_view(alarm)
    for name, axis in state.axes.items():
        earlier = before.axes.get(name) if before else None
        new = axis.knowledge != "learning" or axis.earlier if earlier is None else earlier.knowledge != axis.knowledge
        other = earlier is not None and other_law(earlier, axis)
        turned = earlier is not None and _beside(earlier) != _beside(axis)
        if new or other or turned:
            told = earlier and other and "(law " not in axis.state  # after a change the state itself names both
            law = f" (law {axis.structure}, before {earlier.structure})" if earlier and told else ""
            yield _line(state.time, name, f"{axis.state}{law}{_numbers(axis)}")
    for time, names in _begun(before, state).items():
        yield _line(time, ", ".join(names), "watched for changes from here on")
    for name, axis in state.axes.items():
        earlier = before.axes.get(name) if before else None
        hardly = earlier is not None and earlier.hardly_watched
        if axis.hardly_watched and not hardly:
            share = f"{axis.untested or 0.0:.0%} of the last 40 s"
            why = f"hardly watched: x and y are commanded hard, {share} not tested for changes"
            yield _line(state.time, name, f"{why}; smaller or rarer steps of x and y would have it watched")
        if earlier and hardly and not axis.hardly_watched and axis.watched == earlier.watched:
            yield _line(state.time, name, "no longer hardly watched")
    given = before is not None and before.air is not None
    if state.air and not given:
        yield _line(state.time, "air", f"{_wind(state.air)}; x and y are now known well enough for it")
    elif given and not state.air:
        yield _line(state.time, "air", "x and y are no longer known well enough for the wind")


def _beside(axis: TrackedAxis) -> tuple[bool, bool]:
    """Whether the numbers of an axis are those of the earlier model, and whether this flight contradicts that."""
    return bool(axis.earlier), bool(axis.contradicts)


def _begun(before: Tracked | None, state: Tracked) -> dict[float, list[str]]:
    """The time [s] from which on an alarm can be raised, and could not a second ago, to the axes that it is about."""
    earlier = before.axes if before else {}
    begun: dict[float, list[str]] = {}
    for name, axis in state.axes.items():
        if axis.watched is not None and (name not in earlier or earlier[name].watched is None):
            begun.setdefault(axis.watched, []).append(name)
    return begun


def _line(time: float, name: str, text: str) -> Text:
    line = Text(f"{time:7.1f} s  {name:4}", style="dim")
    line.append(f" {text}", style="default")
    return line


def _numbers(axis: TrackedAxis) -> str:
    """The coefficients that are told, with their intervals."""
    known = [
        f"{name.replace('_', ' ')} {number_text(value, axis.ci95[name])} ({interval_text(axis.ci95[name])})"
        for name, value in axis.values.items()
        if value is not None and name in ("input", "damping", "delay")
    ]
    return f": {', '.join(known)}" if known and (axis.earlier or axis.knowledge in SHOWN_AT_ONCE) else ""


def _apart(axis: TrackedAxis) -> str:
    """How an axis differs from the earlier model."""
    return ", ".join(
        f"{name.replace('_', ' ')} {_times(name, change)} ({_times(name, low)} to {_times(name, high)})"
        for name, (change, low, high) in axis.against.items()
    )


def _times(name: str, change: float) -> str:
    return f"{change:+.3f} s" if name in TIMES else f"{change:.2f}"


def line_of(state: Tracked) -> str:
    """The state in one line."""
    return f"{state.time:.0f} s: {state.words or 'listening'}  (Ctrl-C ends)"


def alarm_view(alarm: Alarm) -> View:
    """What changed, when, by how much, and the reason for the named cause."""
    low, high = alarm.since
    head = Text(f"{alarm.time:7.2f} s  {alarm.title}", style="bold red" if alarm.revises is None else "red")
    if high > 0:  # a vehicle that is another one since the start has not changed
        head.append(f", since {low:.1f} to {high:.1f} s", style="default")
    yield head
    yield indented(f"{alarm.why}.", 11)
    if alarm.change:
        yield indented(f"{changes_of(alarm)}.", 11)


def changes_of(alarm: Alarm) -> str:
    """What changed, and by how much; empty until that is known."""
    return "; ".join(_changed(alarm, name) for name in alarm.change)


def _changed(alarm: Alarm, name: str) -> str:
    """What changed, and the interval of the ratio or of the difference."""
    words, (low, high) = re.sub("[._]", " ", name), alarm.change[name]
    return f"{words} {'times' if alarm.is_ratio(name) else 'by'} {low:.3g} to {high:.3g} {alarm.unit(name)}".rstrip()


def gains_view(message: Mapping[str, Any]) -> View:
    """New gains, and why."""
    for axis, one in message["axes"].items():
        head = Text(f"{message['time']:7.1f} s  GAINS {axis}", style="bold green")
        numbers = (
            f"bandwidth {one['bandwidth']:.3g} rad/s, stiffness {one['stiffness']:.3g}, rate {one['rate_gain']:.3g}"
        )
        head.append(f": {numbers}", style="default")
        yield head
        yield indented(f"{message['why'][axis]}.", 11)
    if message["file"]:
        yield indented(f"Written to {message['file']}.", 11)


def track_view(result: Track) -> View:
    """The axes at the end, and the regimes."""
    last = result.states[-1]
    yield ""
    yield title(f"At {last.time:.1f} s, 95 % intervals of the vehicle as it flew:")
    out = table("axis", "state", "quantity", "value", "unit", "95 %", left=(0, 1, 2, 4))
    for name, axis in last.axes.items():
        known = [(what, axis.values[what]) for what in QUANTITIES if axis.values.get(what) is not None]
        for row, (what, value) in enumerate(known or [("", None)]):
            said = (name, axis.state) if row == 0 else ("", "")
            if value is None:
                out.add_row(*said)
            else:
                unit = UNITS[what].format(POSE_UNITS[name])
                number = number_text(value, axis.ci95[what])
                out.add_row(*said, what.replace("_", " "), number, unit, interval_text(axis.ci95[what]))
        if axis.wind is not None:
            wind = f"{axis.wind:z.2f}", f"{POSE_UNITS[name]}/s^2"
            out.add_row("", "", "wind", *wind, interval_text(axis.wind_ci95))
    yield out
    if any(axis.values.get("input") is not None for axis in last.axes.values()):
        yield indented("input and steady gain are per command of 1", 0)
    yield from bullets(
        f"{name} against the earlier model: {_apart(axis)}" for name, axis in last.axes.items() if axis.against
    )
    yield from bullets((*result.laws_at_end, *result.drifts))
    if result.watch:
        yield indented(result.watch, 0)
    if last.air:
        yield indented(_wind(last.air), 0)
    if len(result.regimes) > 1 or any(one.forgotten for one in result.regimes):
        yield ""
        yield from bullets(
            f"{one.start:.1f} to {one.end:.1f} s: {one.begun_by.named if one.begun_by else 'as it began'}"
            f"{f'; {one.forgotten}' if one.forgotten else ''}"
            for one in result.regimes
        )


def _wind(air: Air) -> str:
    """The mean wind with its intervals; if the air may be still, only the largest possible speed."""
    if not air.significant:
        return f"Mean wind below {number_text(air.speed_ci95[1], air.speed_ci95)} m/s"
    speed = f"{number_text(air.speed, air.speed_ci95)} m/s ({interval_text(air.speed_ci95)})"
    begin, end = (math.degrees(angle) for angle in air.direction_ci95)
    towards = f"{math.degrees(air.direction):z.0f} deg ({begin:z.0f} to {end:z.0f})"
    return f"Mean wind {speed}, towards {towards} from the world's x, counter-clockwise"
