"""Tracked: what is known of a vehicle at one moment of its flight; Alarm: a change of the vehicle; Regime; Track."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import asdict, dataclass, field
from typing import TYPE_CHECKING, Any, Literal, overload

import numpy as np

from rotorfit.core.display import (
    AXIS_COLOURS,
    Band,
    FrameLibrary,
    Line,
    Panel,
    columns_of,
    counted,
    frame,
    html_table,
    interval,
    line_panels,
    number,
)
from rotorfit.core.frames import POSE_UNITS, Array

if TYPE_CHECKING:
    import polars as pl
    from matplotlib.axes import Axes

    from rotorfit.core.finding import Finding
    from rotorfit.core.model import Interval, Model

Knowledge = Literal["learning", "known", "holding", "not_identifiable", "not_excited"]
"""State of an axis: flight too short so far; all coefficients told; not commanded for a while, so that the last values
hold; commanded but not identifiable; not moved by its commands."""

UNMOVED = "not excited: no command moves it"
"""State in words of an axis that is `not_excited` because nothing commands it."""

Cause = Literal["payload", "thrust", "limits", "delay", "pose_jumped", "pose_frozen", "another_vehicle", "other"]
"""Probable cause of a change; see `docs/track.md`."""

QUANTITIES = ("input", "damping", "delay", "lag", "zero", "steady_gain", "total_lag")
"""The quantities of an axis, in the order of the lines that `rotorfit track --jsonl` prints."""

TIMES = ("delay", "lag", "zero", "total_lag")
"""Quantities in s, which are compared by their difference; the others are compared by their ratio."""

HARDLY, SHOWN = 0.5, 0.05
"""Share of the time that is not tested for changes from which an axis counts as hardly watched, and from which the end
of the output gives it."""

RATIOS = ("input", "damping", "lag", "level", "steady_gain")
"""Quantities whose change an alarm gives as a ratio; every other parameter of a law may be zero."""


@dataclass(frozen=True)
class TrackedAxis:
    """State of one axis at one moment.

    Attributes:
        knowledge: In one word.
        state: In words, such as `holding (no excitation for 12 s)`.
        values: Name of `QUANTITIES` to its estimate; None where it is not told.
        ci95: The same to the 95 % interval for the vehicle over its flights; an open end is None.
        ci95_flight: The same to the interval for this flight alone, assuming a vehicle that obeys its law exactly.
        structure: Name of the law.
        wind: Acceleration that the commands do not explain, including the trim [m/s^2, rad/s^2]; None where unknown.
        wind_ci95: Its 95 % interval.
        gusts: Standard deviation of the velocity caused by gusts [m/s, rad/s]; None where unknown.
        velocity: World x, y, z or the yaw rate [m/s, rad/s]; None where unknown.
        ahead: Velocity one second later, if the last command holds [m/s, rad/s]; None where unknown.
        ahead_ci95: Its 95 % band.
        earlier: Name of the earlier model that the values are from; empty where they are from this flight.
        against: Name of `QUANTITIES` to the ratio of this flight's estimate to the earlier model's, for `delay`, `lag`,
            `zero` and `total_lag` the difference [s], with its 95 % interval; only where both tell it, and the values
            are from this flight.
        contradicts: Names of the quantities in which this flight contradicts the earlier model.
        watched: Time of the first test since its last change that could have raised an alarm about it [s]; None before.
        untested: Share of the last 40 s in which it was not tested for changes, since x and y were commanded hard; None
            before the first test.
        untested_in_all: The same of all time so far.
    """

    knowledge: Knowledge = "learning"
    state: str = "learning"
    values: Mapping[str, float | None] = field(default_factory=lambda: dict.fromkeys(QUANTITIES))
    ci95: Mapping[str, Interval] = field(default_factory=dict)
    ci95_flight: Mapping[str, Interval] = field(default_factory=dict)
    structure: str = ""
    wind: float | None = None
    wind_ci95: Interval = (None, None)
    gusts: float | None = None
    velocity: float | None = None
    ahead: float | None = None
    ahead_ci95: Interval = (None, None)
    earlier: str = ""
    against: Mapping[str, tuple[float, float, float]] = field(default_factory=dict)
    contradicts: tuple[str, ...] = ()
    watched: float | None = None
    untested: float | None = None
    untested_in_all: float = 0.0

    @property
    def hardly_watched(self) -> bool:
        """Whether most of the last time was not tested."""
        return self.untested is not None and self.untested > HARDLY

    def to_mapping(self) -> dict[str, Any]:
        """The state as a line of JSON holds it."""
        return {
            "state": self.state,
            **{name: self.values.get(name) for name in QUANTITIES},
            "ci95": {name: list(ends) for name, ends in self.ci95.items()},
            "ci95_flight": {name: list(ends) for name, ends in self.ci95_flight.items()},
            "structure": self.structure,
            "wind": self.wind,
            "wind_ci95": list(self.wind_ci95),
            "gusts": self.gusts,
            "velocity": self.velocity,
            "velocity_in_1_s": self.ahead,
            "velocity_in_1_s_ci95": list(self.ahead_ci95),
            "from": self.earlier or None,
            "against_earlier": {name: list(three) for name, three in self.against.items()},
            "contradicts_earlier": list(self.contradicts),
            "watched_from": self.watched,
            "untested": self.untested,
        }


def other_law(before: TrackedAxis, now: TrackedAxis) -> bool:
    """Whether this flight tells numbers of an axis under another law than before."""
    told = all(any(value is not None for value in one.values.values()) for one in (before, now))
    return told and not before.earlier and not now.earlier and before.structure != now.structure


@dataclass(frozen=True)
class AxisMotion:
    """The motion of one axis at one pose.

    Attributes:
        velocity: World x, y, z or the yaw rate [m/s, rad/s].
        wind: Acceleration that the commands do not explain, including the trim [m/s^2, rad/s^2].
        wind_ci95: Its 95 % interval.
        gusts: Standard deviation of the velocity caused by gusts [m/s, rad/s].
        ahead: Velocity one second later, if the last command holds [m/s, rad/s].
        ahead_ci95: Its 95 % band.
    """

    velocity: float
    wind: float
    wind_ci95: tuple[float, float]
    gusts: float
    ahead: float
    ahead_ci95: tuple[float, float]

    def to_mapping(self) -> dict[str, Any]:
        """The motion under the names that a state has in JSON."""
        return {
            "velocity": self.velocity,
            "wind": self.wind,
            "wind_ci95": list(self.wind_ci95),
            "gusts": self.gusts,
            "velocity_in_1_s": self.ahead,
            "velocity_in_1_s_ci95": list(self.ahead_ci95),
        }


@dataclass(frozen=True)
class Motion:
    """The motion at the last pose, with the coefficients of the last look.

    Attributes:
        time: Stamp of the pose, in seconds of the flight.
        axes: Axis name to its motion, for the axes whose damping is told.
    """

    time: float
    axes: Mapping[str, AxisMotion]

    def to_mapping(self) -> dict[str, Any]:
        """The motion as JSON holds it."""
        return {
            "type": "motion",
            "time": self.time,
            "axes": {name: axis.to_mapping() for name, axis in self.axes.items()},
        }


@dataclass(frozen=True)
class Air:
    """Mean wind over the last 40 s, where commands are tilts and damping is drag.

    speed: Wind speed [m/s].
    speed_ci95: Its 95 % interval [m/s].
    direction: Direction that the wind blows towards, counter-clockwise from the world's x [rad].
    direction_ci95: Its 95 % interval [rad].
    """

    speed: float
    speed_ci95: tuple[float, float]
    direction: float
    direction_ci95: tuple[float, float]

    @property
    def significant(self) -> bool:
        """Whether the wind is distinguishable from still air, which has no direction."""
        begin, end = self.direction_ci95
        return self.speed_ci95[0] > 0 and end - begin < 2 * np.pi * (1 - 1e-9)

    def to_mapping(self) -> dict[str, Any]:
        """The wind as a line of JSON holds it."""
        return {
            "speed": self.speed,
            "speed_ci95": list(self.speed_ci95),
            "direction": self.direction,
            "direction_ci95": list(self.direction_ci95),
        }


@dataclass(frozen=True)
class Alarm:
    """A detected change of the vehicle, or of what measures it; or what more data tell of one that has been raised.

    Attributes:
        time: When it was raised, or revised [s].
        axes: The axes that changed.
        cause: Probable cause.
        since: 95 % interval of the time of the change [s].
        change: `AXIS.QUANTITY` to the 95 % interval of the ratio of new to old; for `delay`, `zero` and `trim`, and
            where the vehicle is another one for `lag` and `total_lag`, of the difference [s, m/s^2 or rad/s^2]. Empty
            until it is revised.
        confidence: Share of the evidence for this cause among all that were compared.
        p_value: Probability of at least as much evidence without a change, before correction for the number of looks.
        why: Why this cause and not the others, one sentence.
        revises: Time of the alarm that it takes the place of [s]; None for a new alarm.
        turned: Whether the pose jumped in heading, so that commands of x and y may act in other directions than before.
    """

    time: float
    axes: tuple[str, ...]
    cause: Cause
    since: tuple[float, float]
    change: Mapping[str, tuple[float, float]]
    confidence: float
    p_value: float
    why: str
    revises: float | None = None
    turned: bool = False

    @property
    def raised(self) -> float:
        """When it was raised first [s]."""
        return self.time if self.revises is None else self.revises

    @property
    def named(self) -> str:
        """The cause in words."""
        return self.cause.replace("_", " ")

    @property
    def title(self) -> str:
        """Axes and cause in words, and whether the alarm is new."""
        named = f"{', '.join(self.axes)}: {self.named}"
        return f"ALARM {named}" if self.revises is None else f"REVISED {named}, alarm of {self.revises:.2f} s"

    def is_ratio(self, name: str) -> bool:
        """Whether an interval in `change` is of the new value over the old one; else of their difference."""
        what = name.split(".")[1]
        return what in RATIOS and not (self.cause == "another_vehicle" and what in TIMES)

    def unit(self, name: str) -> str:
        """Unit of an interval in `change`; empty for a ratio, and for a difference without or in a rare unit."""
        axis, what = name.split(".")
        if what == "trim":
            return f"{POSE_UNITS[axis]}/s^2"
        return "s" if what in TIMES and not self.is_ratio(name) else ""

    def to_mapping(self) -> dict[str, Any]:
        """The alarm as a line of JSON holds it."""
        return {
            "type": "alarm",
            "time": self.time,
            "axes": list(self.axes),
            "cause": self.cause,
            "since": list(self.since),
            "change": {name: list(ends) for name, ends in self.change.items()},
            "confidence": self.confidence,
            "p_value": self.p_value,
            "why": self.why,
            "revises": self.revises,
        }


def revised(alarms: Iterable[Alarm]) -> tuple[Alarm, ...]:
    """Alarms in order, a revision in the place of the alarm that it revises."""
    out: list[Alarm] = []
    for alarm in alarms:
        place = next((n for n in reversed(range(len(out))) if out[n].raised == alarm.revises), len(out))
        out[place : place + 1] = [alarm]
    return tuple(out)


def alarm_from_mapping(mapping: Mapping[str, Any]) -> Alarm:
    """The alarm from its attributes as stored in a file."""
    pairs = {name: tuple(mapping[name]) for name in ("axes", "since")}
    change = {name: tuple(ends) for name, ends in mapping["change"].items()}
    return Alarm(**{**mapping, **pairs, "change": change})


@dataclass(frozen=True)
class Regime:
    """A stretch of flight in which the vehicle did not change.

    Attributes:
        start: Start [s].
        end: End [s].
        model: Its model: each axis is fitted to all of the flight around the regime in which it did not change. None
            where that is too short for every axis.
        begun_by: The alarm at its start; None for the first.
        data: From which to which second of the flight its model was fitted [s]; None without one.
        remembered: From which second on the flight was remembered at its end [s]; None where that is all of the regime.
    """

    start: float
    end: float
    model: Model | None
    begun_by: Alarm | None = None
    data: tuple[float, float] | None = None
    remembered: float | None = None

    @property
    def forgotten(self) -> str:
        """What of it was no longer remembered at the end of the flight, in words; empty if nothing."""
        if self.remembered is None:
            return ""
        lost = f"seconds before {self.remembered:.1f} were no longer remembered at the end"
        return f"{lost}: model from {self.data[0]:.1f} to {self.data[1]:.1f} s" if self.data else f"{lost}: no model"


@dataclass(frozen=True)
class Tracked:
    """State of a tracked vehicle at one moment.

    Attributes:
        time: In seconds of the flight.
        axes: Axis name to its state.
        alarms: Alarms raised or revised since the previous state.
        regime: Number of the regime, from 0.
        regime_start: When it began [s].
        air: The mean wind; None where it is unknown, or where damping is not drag.
        model: Model of the last refit of each axis, for `validate`, `tune` and `export`; None before the first.
        landed: Whether it is the last state, after a final fit of all data.
        findings: Faults of the data since the heading last jumped: those of `MISREAD`, and all at the last state; None
            before they can be told.
    """

    time: float
    axes: Mapping[str, TrackedAxis]
    alarms: tuple[Alarm, ...] = ()
    regime: int = 0
    regime_start: float = 0.0
    air: Air | None = None
    model: Model | None = field(default=None, compare=False, repr=False)
    landed: bool = False
    findings: tuple[Finding, ...] | None = None

    @property
    def unwatched(self) -> tuple[str, ...]:
        """The commanded axes about which no test could raise an alarm yet, since the start or since their change."""
        return tuple(name for name, one in self.axes.items() if one.watched is None and UNMOVED not in one.state)

    @property
    def blind(self) -> str:
        """The axes about which no alarm, or hardly one, can be raised now, in words; empty if there are none."""
        hardly = [name for name, one in self.axes.items() if one.hardly_watched]
        unwatched = [name for name in self.unwatched if name not in hardly]
        told = {"not yet watched for changes": unwatched, "hardly watched, x and y are commanded hard": hardly}
        return "; ".join(f"{words}: {', '.join(names)}" for words, names in told.items() if names)

    @property
    def faults(self) -> dict[str, str]:
        """The faults of the data in words, each by its code, axis and regime: after a change they are others."""
        return {
            f"{one.code} {one.axis} {self.regime}": one.line for one in self.findings or () if one.severity != "info"
        }

    @property
    def words(self) -> str:
        """The state of each axis in a few words, and the axes that are not watched; empty without axes."""
        axes = ", ".join(f"{name} {axis.state.partition(' (')[0]}" for name, axis in self.axes.items())
        return axes + (f"; {self.blind}" if self.blind else "")

    def to_mapping(self) -> dict[str, Any]:
        """The state as a line of JSON holds it."""
        return {
            "type": "state",
            "time": self.time,
            "regime": self.regime,
            "axes": {name: axis.to_mapping() for name, axis in self.axes.items()},
            "air": self.air.to_mapping() if self.air else None,
            "findings": None if self.findings is None else [asdict(finding) for finding in self.findings],
        }


DRIFTING, CERTAIN = ("time", "quarter"), 1e-5
"""Tests of a fit that show a vehicle that changes in flight, and the p-value below which one is told of."""

TIMELINE = ("input", "damping", "delay")
"""The quantities shown in a figure of the whole flight."""

WIDEST = 6.0
"""A plot ignores intervals wider than this many times their median when it sets its scale: they are wide at first."""


@dataclass(frozen=True)
class Timeline:
    """One quantity of one axis over the flight, at the time of each state; NaN where it was not told.

    Attributes:
        time: Shape (S,) [s].
        value: Estimates, shape (S,).
        low: Lower ends of the 95 % intervals, shape (S,); NaN where open.
        high: Upper ends, shape (S,); NaN where open.
    """

    time: Array
    value: Array
    low: Array
    high: Array

    @property
    def shown(self) -> tuple[float, float] | None:
        """Range of the y axis, ignoring the ends of disproportionately wide intervals; None without values."""
        told = np.isfinite(self.value)
        if not told.any():
            return None
        width = self.high - self.low
        usual = np.nanmedian(width) if np.isfinite(width).any() else np.inf
        kept = told & (width <= WIDEST * usual)
        ends = np.concatenate([self.value[kept] if kept.any() else self.value[told], self.low[kept], self.high[kept]])
        low, high = float(np.nanmin(ends)), float(np.nanmax(ends))
        margin = 0.06 * (high - low) or 0.1 * abs(high) or 1.0
        return low - margin, high + margin


@dataclass(frozen=True, repr=False)
class Track:
    """A whole tracked flight.

    Attributes:
        states: One per second and one per alarm between, in order; the last is at the end, after a final fit.
        regimes: In order, each with its model.
    """

    states: tuple[Tracked, ...]
    regimes: tuple[Regime, ...]

    @property
    def alarms(self) -> tuple[Alarm, ...]:
        """All alarms, in order, each as it was revised last."""
        return revised(alarm for state in self.states for alarm in state.alarms)

    @property
    def watch(self) -> str:
        """From when on each axis was tested for changes, in words; empty for a track without axes."""
        words = {axis: self._watch_of(axis) for axis in (self.states[-1].axes if self.states else {})}
        groups = {told: ", ".join(axis for axis, other in words.items() if other == told) for told in words.values()}
        told = [f"{names} {told}" for told, names in groups.items()]
        return f"Watched for changes: {'; '.join(told)}" if told else ""

    @property
    def faults(self) -> tuple[str, ...]:
        """The faults of the data that the last state knows, in words."""
        last = self.states[-1].faults if self.states else {}
        return tuple(last.values())

    @property
    def laws_at_end(self) -> tuple[str, ...]:
        """The axes to which the last fit gave another law than the state before had, in words."""
        before = next((state.axes for state in reversed(self.states) if not state.landed), {})
        last = self.states[-1].axes if self.states and self.states[-1].landed else {}
        return tuple(
            f"{axis}: the last fit is under law {one.structure}, numbers told before it are under "
            f"{before[axis].structure}: only steady gain and total lag compare"
            for axis, one in last.items()
            if axis in before and other_law(before[axis], one)
        )

    @property
    def drifts(self) -> tuple[str, ...]:
        """The axes of the last regime that certainly varied within it, without an alarm, in words."""
        models = [regime.model for regime in self.regimes if regime.model]
        worst = {
            axis: min(told, key=lambda each: each.p_value)
            for axis, one in (models[-1].axes.items() if models else ())
            if (told := [each for each in one.evidence if each.test in DRIFTING and each.p_value < CERTAIN])
        }
        return tuple(
            f"{axis}: {each.strength} (p = {each.p_value:.1g}), yet no seconds differed enough for an alarm: it "
            "drifts, changed where wind or other axes hid it, or its commands bear wrong stamps; the intervals allow "
            "for it"
            for axis, each in worst.items()
        )

    def _watch_of(self, axis: str) -> str:
        """When an axis was tested for changes, in words: not until enough is known of it, and of it as it changed."""
        spans: list[tuple[float, float | None]] = []
        for state in self.states:
            since = state.axes[axis].watched if axis in state.axes else None
            if spans and spans[-1][1] is None and since != spans[-1][0]:
                spans[-1] = spans[-1][0], state.time
            if since is not None and (not spans or since != spans[-1][0]):
                spans.append((since, None))
        told = [f"from {begin:.1f} s {'on' if end is None else f'to {end:.1f} s'}" for begin, end in spans]
        untested = _at(self.states[-1], axis).untested_in_all
        hard = f" ({untested:.0%} of the time untested: x and y were commanded hard)" if untested > SHOWN else ""
        return (" and ".join(told) or "never") + hard

    @property
    def axes(self) -> tuple[str, ...]:
        """Names of the axes moved by a command, in the order of the states."""
        names = dict.fromkeys(name for state in self.states for name in state.axes)
        return tuple(n for n in names if any(_at(state, n).knowledge != "not_excited" for state in self.states))

    def timeline(self, axis: str, name: str) -> Timeline:
        """One quantity of one axis over the flight, as told by this flight; values of an earlier model are left out.

        Args:
            axis: `x`, `y`, `z` or `yaw`.
            name: One of `QUANTITIES`, or `wind`.
        """
        every = [TrackedAxis() if (one := _at(state, axis)).earlier else one for state in self.states]
        if name == "wind":
            rows = [(one.wind, *one.wind_ci95) for one in every]
        else:
            rows = [(one.values.get(name), *_ends(one, name)) for one in every]
        time = np.array([state.time for state in self.states])
        return Timeline(time, *np.array(rows, float).reshape(-1, 3).T)

    def __repr__(self) -> str:
        end = self.states[-1].time if self.states else 0.0
        said = f"{end:.1f} s", counted(len(self.regimes), "regime"), counted(len(self.alarms), "alarm")
        return f"Track({', '.join(said)})"

    def _repr_html_(self) -> str:
        rows = [
            (axis, one.state, name.replace("_", " "), number(one.values[name]), interval(*_ends(one, name)))
            for axis, one in (self.states[-1].axes.items() if self.states else ())
            for name in QUANTITIES
            if one.values.get(name) is not None
        ]
        raised = [
            (f"{a.raised:.1f} s", ", ".join(a.axes), a.cause, f"{a.since[0]:.1f} to {a.since[1]:.1f} s")
            for a in self.alarms
        ]
        alarms = html_table("Alarms", ("raised", "axes", "cause", "since"), raised) if raised else ""
        return html_table(repr(self), ("axis", "state", "quantity", "value", "95 % interval"), rows) + alarms

    @overload
    def to_frame(self, library: Literal["polars"] = "polars") -> pl.DataFrame: ...
    @overload
    def to_frame(self, library: Literal["pandas"]) -> Any: ...
    def to_frame(self, library: FrameLibrary = "polars") -> Any:
        """The states as a data frame, one row for each state and axis.

        Args:
            library: `polars`, or `pandas`, which must be installed.

        Returns:
            A `DataFrame` with the columns `time` [s], `regime`, `axis`, `knowledge`, `state` in words, `earlier` (the
            model that the values are from, if not this flight), `structure`; for each quantity `NAME`, `NAME_low` and
            `NAME_high`, the ends of its 95 % interval; `wind`, `wind_low`, `wind_high`, `gusts`, `velocity`, `ahead`,
            `ahead_low`, `ahead_high`; null where unknown, and for open ends.

        Raises:
            ModuleNotFoundError: pandas is requested but not installed.
        """
        with_ends = [(name, f"{name}_low", f"{name}_high") for name in (*QUANTITIES, "wind", "ahead")]
        heads = ("time", "regime", "axis", "knowledge", "state", "earlier", "structure", "gusts", "velocity")
        rows = [
            (
                state.time, state.regime, name, one.knowledge, one.state, one.earlier or None, one.structure, one.gusts,
                one.velocity,
                *(part for what in QUANTITIES for part in (one.values.get(what), *_ends(one, what))),
                one.wind, *one.wind_ci95, one.ahead, *one.ahead_ci95,
            )
            for state in self.states
            for name, one in state.axes.items()
        ]  # fmt: skip
        return frame(columns_of([*heads, *(head for three in with_ends for head in three)], rows), library)

    def plot(self) -> tuple[Axes, ...]:
        """Draws input, damping and delay of each axis over the flight, with their 95 % intervals.

        Every second regime is grey; alarms are vertical lines.

        Returns:
            The matplotlib axes, row by row: one row for each quantity, one column for each moved axis; empty without
            one.
        """
        units = {"damping": "1/s", "delay": "s"}
        grey = [(one.start, one.end) for one in self.regimes[1::2]]
        alarms = [alarm.raised for alarm in self.alarms]
        panels = []
        for name in TIMELINE:
            for axis in self.axes:
                one, colour = self.timeline(axis, name), AXIS_COLOURS[axis]
                unit = units.get(name, f"{POSE_UNITS[axis]}/s²")
                line = Line("estimate", one.time, one.value, {"color": colour, "linewidth": 1.4})
                band = Band("95 % interval", one.time, one.low, one.high, colour)
                panels.append(
                    Panel(
                        f"{axis}: {name}", "time [s]", f"{name} [{unit}]", [line], grey, bands=[band], moments=alarms,
                        y_range=one.shown,
                    )
                )  # fmt: skip
        return line_panels(panels, max(len(self.axes), 1), (3.4, 2.0)) if panels else ()


def _at(state: Tracked, axis: str) -> TrackedAxis:
    return state.axes.get(axis, TrackedAxis())


def _ends(axis: TrackedAxis, name: str) -> Interval:
    return axis.ci95.get(name, (None, None))
