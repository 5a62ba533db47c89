"""The estimates and the regimes of a growing flight, updated by a look once a second.

A look takes an estimation step or a refit for each group of axes (`refits`), tests the last seconds against the rest of
the regime (`changes`), and assembles the state in report and numbers. Between looks, glances only test.

An alarm is raised by the look or glance that finds a change, with the cause that is probable by then. It begins a new
regime. A second later the cause is named again, from the estimates before the change and more data, and the alarm is
revised: its regime is then as if it had been raised like that. Only then it says by how much: in a fraction of a second
the size of a change and its time explain each other, and no interval of either alone holds.
"""

from collections.abc import Collection, Mapping, Sequence
from dataclasses import asdict, dataclass, replace
from typing import Any

import numpy as np

from rotorfit.core.flight_data import Flight
from rotorfit.core.frames import AXES
from rotorfit.core.laws import AVERAGED
from rotorfit.core.model import NORMAL, Interval, Model
from rotorfit.core.results import Fit
from rotorfit.core.tracked import UNMOVED, Alarm, Knowledge, Regime, Tracked, TrackedAxis, alarm_from_mapping
from rotorfit.diagnosis.position_loop import restored_axes
from rotorfit.estimation.fitting import fit
from rotorfit.estimation.grouping import commands_axis, groups_of
from rotorfit.estimation.identifiability import LEAST_TIME
from rotorfit.estimation.likelihood.axis_estimate import Estimate
from rotorfit.estimation.likelihood.optima import between
from rotorfit.estimation.zero_command import commanded_parts, late_by
from rotorfit.tracking.air import AxisNow, Course, courses
from rotorfit.tracking.causes import diagnosis
from rotorfit.tracking.changes import (
    LEAST_CHUNKS,
    Contrast,
    at_once,
    calm,
    compares,
    in_any_air,
    looked_for,
    looked_together,
    pushes,
    since_when,
)
from rotorfit.tracking.drag import damping_interval, is_drag, tells_wind, widening, with_drag
from rotorfit.tracking.earlier import SHARE, Earlier, another_vehicle, compared, told_after
from rotorfit.tracking.refits import (
    LONGEST,
    REFIT,
    AxisReport,
    GroupEstimate,
    axis_report,
    doubt_of,
    group_estimate,
    grown,
    growth,
    refitted,
    renewed,
    stepped,
    together,
)
from rotorfit.tracking.scores import CHUNK, GUST_POWERS, WINDOWS, Doubts, Estimates, Scores, let_go, scores_of
from rotorfit.tracking.wind_error import coefficient_error

EVERY, GLANCE = 1.0, 0.25
"""Time between looks, and between glances [s]."""

SHORT = tuple(window for window in WINDOWS if window <= 16 * GLANCE)
"""Lengths of the windows that a glance tests [s]: in a longer one little is new since the last look."""

REVISED = 1.0
"""Time from an alarm to its revision [s]."""

FALSE_ALARMS_PER_HOUR = 0.1
"""Promised rate of false alarms by default [1/h]."""

RESTLESS = 0.97
"""Commanded share of a regime above which the vehicle's behaviour at rest cannot explain a change."""

BEGINS = 0.1
"""Step by which the beginning of what a look uses of a long regime moves, as a share of `LONGEST`."""

ENOUGH, FEW = 11.0, 20
"""Time from which on a fit tests whether an axis is only held [s]: `position_loop.LEAST` averages. Before that the test
is made at each look, with this number of averages."""

Span = tuple[float, float]
"""Start and end [s]."""

HELD = "its commands only answer its motion"

QUIET = 5.0
"""Time without a new command after which an axis is `holding` [s]: by then it has answered the last one."""


@dataclass(frozen=True)
class Group:
    """Axes that are fitted together.

    Attributes:
        axes: Names.
        since: Start of their regime [s].
        fitted: Their estimate; None before the first fit.
        excited: Excited time since the start of the regime [s].
        looked: Time up to which `excited` was counted [s].
        answers: Delay of the answers to commands and twice their lag [s], if only those are fitted because the axes
            obey another law at rest; None if all of the flight is.
    """

    axes: tuple[str, ...]
    since: float
    fitted: GroupEstimate | None = None
    excited: float = 0.0
    looked: float = 0.0
    answers: float | None = None

    def part(self, flight: Flight, since: float, now: float) -> Flight | None:
        """The part of a flight between two times [s] that is fitted; None if it is empty."""
        part = _part(flight, since, now)
        if part is None or self.answers is None:
            return part
        part = commanded_parts(part, self.axes, self.answers)
        return part if part.segments else None


@dataclass(frozen=True)
class _Before:
    """Regimes and estimates before a change.

    Attributes:
        since, changed: Axis to the start of its regime, and to the time of its last change [s].
        bounds: Start of each regime [s] and its alarm.
        groups: Groups of axes.
    """

    since: Mapping[str, float]
    changed: Mapping[str, float]
    bounds: Sequence[tuple[float, Alarm | None]]
    groups: Mapping[tuple[str, ...], Group]


@dataclass(frozen=True)
class _Raised:
    """An alarm that will be revised.

    Attributes:
        alarm: The alarm.
        names: Names of the scores of the likelihood that shows the change.
        contrast: Its contrast.
        looked: All contrasts of that look, by the names of their scores.
        before: What was known before.
    """

    alarm: Alarm
    names: tuple[str, ...]
    contrast: Contrast
    looked: Mapping[tuple[str, ...], Sequence[Contrast]]
    before: _Before


class Following:
    """The estimates and regimes of a growing flight.

    Args:
        structure: Model structure, as `fit` takes it.
        false_alarms_per_hour: Promised bound on their expected number [1/h].
        earlier: The model of an earlier flight; None if there is none.
        tuned: Whether gains are re-tuned from the refits; these are then made more often, as with an earlier model,
            with which each is compared.

    Attributes:
        next_look: Time of the next look [s].
        courses: Motion filters of the last look, ready to be continued.
        doubt: Axis name to the standard error of the wind due to the coefficients [m/s^2, rad/s^2].
    """

    def __init__(
        self,
        structure: str = AVERAGED,
        false_alarms_per_hour: float = FALSE_ALARMS_PER_HOUR,
        earlier: Earlier | None = None,
        tuned: bool = False,
    ) -> None:
        self._structure, self._earlier, self._often = structure, earlier, tuned or earlier is not None
        self._false_alarms = false_alarms_per_hour * (1.0 - SHARE if earlier else 1.0)
        self._false_comparisons = false_alarms_per_hour * SHARE
        self._compared, self._unlike = 0.0, set[str]()
        self._groups: dict[tuple[str, ...], Group] = {}
        self._since = dict.fromkeys(AXES, 0.0)
        self._changed: dict[str, float] = {}
        self._laws: dict[str, str] = {}
        self._known: dict[str, float] = {}
        self._raised: _Raised | None = None
        self._watched: dict[str, float] = {}
        self._bounds: list[tuple[float, Alarm | None]] = [(0.0, None)]
        self._model: tuple[tuple[Fit, ...], Model | None] = ((), None)
        self.next_look = LEAST_TIME
        self.courses: tuple[Course, ...] = ()
        self.doubt: dict[str, float] = {}

    def follow(self, flight: Flight, now: float, standing: bool = False) -> Tracked | None:
        """A look at the flight so far, if one is due; else a glance. See both."""
        return (self.look if now > self.next_look - 1e-6 else self.glance)(flight, now, standing)

    def glance(self, flight: Flight, now: float, standing: bool = False) -> Tracked | None:
        """Tests whether the vehicle has changed, without a step of the estimates; None if there is no alarm.

        Args:
            flight: As in `look`.
            now: As in `look`.
            standing: As in `look`.
        """
        alarm = self._change(flight, now, standing, SHORT)
        return self._tracked(flight, now, (alarm,)) if alarm else None

    def look(self, flight: Flight, now: float, standing: bool = False) -> Tracked:
        """A look at the flight so far.

        Args:
            flight: Its samples up to now.
            now: Time of the look [s].
            standing: Whether the vehicle stands, or takes off or lands by itself: then no change is tested for.

        Returns:
            The state, with the alarms of this look.
        """
        self.next_look = next_look(self.next_look, now)
        before = self._as_refitted()
        self._groups = {axes: self._looked(axes, flight, now) for axes in groups_of([flight], flight.axes)}
        alarm = self._change(flight, now, standing)
        state = self._tracked(flight, now, (alarm,) if alarm else ())
        if self._earlier and not alarm and state.model is not before:
            unlike = self._another_vehicle(state, self._earlier)
            return replace(state, alarms=(unlike,)) if unlike else state
        return state

    def memory(self) -> dict[str, Any]:
        """Regimes and the time of the next look, as plain types; `recall` leaves the estimates to new fits."""
        bounds = [(since, asdict(alarm) if alarm else None) for since, alarm in self._bounds]
        told = {"compared": self._compared, "unlike": sorted(self._unlike), "watched": dict(self._watched)}
        since = {"since": dict(self._since), "changed": dict(self._changed), "laws": dict(self._laws)}
        return {**since, "bounds": bounds, "next_look": float(self.next_look), **told}

    def recall(self, memory: Mapping[str, Any]) -> None:
        """Continues from what `memory` returned."""
        self._since, self._changed = dict(memory["since"]), dict(memory["changed"])
        self._laws = dict(memory.get("laws", {}))
        self.next_look = memory["next_look"]
        self._bounds = [(since, alarm_from_mapping(alarm) if alarm else None) for since, alarm in memory["bounds"]]
        self._compared, self._unlike = memory.get("compared", 0.0), set(memory.get("unlike", ()))
        self._watched = dict(memory.get("watched", {}))

    def finish(self, flight: Flight, now: float) -> tuple[Tracked, tuple[Regime, ...]]:
        """The final state, after a last fit of each group, and the regimes with their models.

        A change of some axes ends nothing for the others: each group is fitted to all of the flight around a regime in
        which it did not change. So the model of the last regime is that of the final state.

        Args:
            flight: The whole flight.
            now: Its end [s].
        """
        groups = groups_of([flight], flight.axes) or [AXES]
        ends = [*(since for since, _ in self._bounds[1:]), now]
        spans = [(since, end) for (since, _), end in zip(self._bounds, ends, strict=True)]
        unchanged = [{axes: self._unchanged(axes, span, now) for axes in groups} for span in spans]
        fitted: dict[Span, set[str]] = {}
        for each in unchanged:
            for axes, span in each.items():
                fitted[span] = fitted.get(span, set()) | set(axes)
        fits = {span: self._fit(flight, span, AXES if len(fitted) == 1 else axes) for span, axes in fitted.items()}
        parts = [
            {axes: group_estimate(found, axes, now) for axes, span in each.items() if (found := fits[span])}
            for each in unchanged
        ]
        regimes = tuple(
            Regime(*span, together(list(each.values())), alarm)
            for span, each, (_, alarm) in zip(spans, parts, self._bounds, strict=True)
        )
        last = {axes: self._groups.get(axes, Group(axes, unchanged[-1][axes][0])) for axes in groups}
        self._groups = {axes: replace(one, fitted=parts[-1].get(axes, one.fitted)) for axes, one in last.items()}
        return replace(self._tracked(flight, now, ()), landed=True), regimes

    def _unchanged(self, axes: Sequence[str], regime: Span, now: float) -> Span:
        """The time around a regime in which none of some axes changed [s]."""
        changes = [since for since, alarm in self._bounds if alarm and set(alarm.axes) & set(axes)]
        start, end = regime
        return max((t for t in changes if t <= start), default=0.0), min((t for t in changes if t >= end), default=now)

    def _fit(self, flight: Flight, span: Span, axes: Collection[str]) -> Fit | None:
        """The fit of some axes to a stretch of the flight [s]; None if it is too short."""
        part = _part(flight, *span)
        wanted = [axis for axis in AXES if axis in axes]
        return fit([part], axes=wanted, structure=self._structure) if part and part.duration >= LEAST_TIME else None

    def _looked(self, axes: tuple[str, ...], flight: Flight, now: float) -> Group:
        """A group after this look."""
        since = max(self._since[axis] for axis in axes)
        group = self._groups.get(axes, Group(axes, since))
        if group.since != since:
            group = Group(axes, since, answers=group.answers)
        part = group.part(flight, _looks_back(since, now), now)
        if part is None or part.duration < LEAST_TIME:
            return group
        excited = group.excited + _excited(flight, axes, max(group.looked, since), now)
        group, before = replace(group, excited=excited, looked=now), group.fitted
        if before and all(_quiet(flight, axis, now) > QUIET for axis in axes):
            return replace(group, fitted=renewed(before, part))  # no excitation: the last values hold
        if before is None or grown(before.seen, excited, REFIT if before.estimates and self._often else growth(before)):
            return replace(group, fitted=refitted(part, axes, self._structure, excited))
        return replace(group, fitted=stepped(before, part, excited))

    def _change(self, flight: Flight, now: float, standing: bool, lengths: Sequence[float] = WINDOWS) -> Alarm | None:
        """The alarm that is raised or revised now, if there is one; it begins a new regime.

        Args:
            flight: As in `look`.
            now: As in `look`.
            standing: As in `look`.
            lengths: Lengths of the windows that are tested [s].
        """
        raised, self._raised = self._raised, None
        if standing:
            return None
        if raised and now < raised.alarm.time + REVISED - 1e-6:
            self._raised = raised
            return None
        before = raised.before if raised else _Before(self._since, self._changed, self._bounds, self._groups)
        if all(now - group.since < (LEAST_CHUNKS - 1) * CHUNK for group in before.groups.values()):
            return None  # no window has a rest that is long enough
        known = _renewed(before.groups, flight, now)
        scored = {scores.names: scores for scores in scores_of_groups(known, flight)}
        watched = self._watched_again()
        looked, count = looked_together(list(scored.values()), lengths)
        for scores in scored.values():
            axes = {name.partition(".")[0] for name in scores.names}
            if not raised and not axes <= watched.keys() and compares(scores, lengths):
                self._watched = {**self._watched, **dict.fromkeys(axes - watched.keys(), now)}
        threshold = self._false_alarms * GLANCE / 3600.0 / max(count, 1)
        found = [(names, one) for names, each in looked.items() for one in each if one.p_value < threshold]
        if raised:
            found = [(raised.names, raised.contrast)]
        if not found or found[0][0] not in scored:
            return None
        names, first = min(found, key=lambda each: each[1].p_value)
        p_value = first.p_value
        if not raised and pushes(names, first):
            under = [scores_of_groups(known, flight, gusts) for gusts in range(1 + len(GUST_POWERS))]
            p_value = max(p_value, in_any_air(names, under, lengths))
            if p_value > threshold:
                return None  # perhaps a gust
        best, since = since_when(scored[names], first, looked[names])
        if not raised and not calm(scored[names], best.since, p_value):
            return None  # the air, not the vehicle
        if not raised and self._at_rest(flight, now, names, threshold):
            return None  # the vehicle has not changed: it obeys another law at rest
        earlier = raised.looked if raised else {}
        others = [
            (scores, there)
            for other, scores in scored.items()
            if other != names and (there := at_once(scores, [*earlier.get(other, ()), *looked[other]], best))
        ]
        named = diagnosis([(scored[names], best), *others])
        alarm = Alarm(
            time=now,
            axes=tuple(axis for axis in AXES if axis in named.axes),
            cause=named.cause,
            since=since,
            change=named.change if raised else {},
            confidence=named.confidence,
            p_value=p_value,
            why=named.why,
            revises=raised.alarm.time if raised else None,
        )
        self._raised = None if raised else _Raised(alarm, names, first, looked, before)
        self._begin(alarm, best.since, before)
        return alarm

    def _watched_again(self) -> dict[str, float]:
        """Axis to the time of the first test since its last alarm that could have raised another [s]."""
        raised = {axis: alarm.raised for _, alarm in self._bounds if alarm for axis in alarm.axes}
        return {axis: time for axis, time in self._watched.items() if time > raised.get(axis, 0.0)}

    def _begin(self, alarm: Alarm, since: float, before: _Before) -> None:
        """Begins a regime for the axes of an alarm; an axis that only its first version named is as it was before."""
        changed = dict.fromkeys(alarm.axes, since)
        self._known = {axis: time for axis, time in self._known.items() if axis not in changed}
        self._since, self._changed = {**before.since, **changed}, {**before.changed, **changed}
        self._bounds = sorted([*before.bounds, (since, alarm)], key=lambda bound: bound[0])
        groups = dict(self._groups)
        for axes, group in groups.items():
            known = before.groups.get(axes, group)
            if known.fitted:
                laws = {axis: known.fitted.fit.model.axes[axis].structure for axis in known.fitted.estimates}
                self._laws |= {axis: law for axis, law in laws.items() if axis in alarm.axes}
            if set(axes) & set(alarm.axes):
                groups[axes] = Group(axes, since, answers=group.answers)
            elif group.since != known.since:
                groups[axes] = known
        self._groups = groups

    def _another_vehicle(self, state: Tracked, earlier: Earlier) -> Alarm | None:
        """The alarm that the vehicle is not that of the earlier model, if a refit shows it.

        The promised false alarms accrue with time: a comparison may spend those of the time since the last one.
        """
        axes = {
            axis: one
            for axis, one in state.axes.items()
            if one.against and axis not in self._changed and axis not in self._unlike
        }
        every = [unlike for axis, one in axes.items() for unlike in compared(one, earlier, axis)]
        if not every:
            return None
        threshold = self._false_comparisons * (state.time - self._compared) / 3600.0 / len(every)
        self._compared = state.time
        found = [one for one in every if one.p_value < threshold]
        self._unlike |= {one.name.partition(".")[0] for one in found}
        return another_vehicle(found, earlier, state.time) if found else None

    def _at_rest(self, flight: Flight, now: float, names: Sequence[str], threshold: float) -> bool:
        """Whether a change was only found because x and y obey another law at rest: many vehicles brake or hold there.

        That is so if they show no change when fitted to their answers to commands alone; from then on they are.
        """
        for axes, group in self._groups.items():
            if group.fitted is None or group.answers is not None or set(axes) & {"z", "yaw"}:
                continue
            if not any(name.split(".")[0] in axes for name in names):
                continue
            late = [late_by(one) for one in group.fitted.estimates.values()]
            apart = replace(group, answers=min(late))
            begin = _looks_back(group.since, now)
            part = apart.part(flight, begin, now)
            if part is None or part.duration < LEAST_TIME or part.duration > RESTLESS * (now - begin):
                continue
            fitted = refitted(part, axes, self._structure, group.fitted.seen)
            if fitted.estimates and not any(
                one.p_value < threshold for scores in scores_of_groups([fitted], flight) for one in looked_for(scores)
            ):
                self._groups[axes] = replace(apart, fitted=fitted)
                return True
        return False

    def _tracked(self, flight: Flight, now: float, alarms: tuple[Alarm, ...]) -> Tracked:
        """The state in words and numbers."""
        held = {axis for group in self._groups.values() for axis in _held(group, flight, now)}
        known = {axis: None if axis in held else one.fitted for axes, one in self._groups.items() for axis in axes}
        estimates = {axis: one.estimates[axis] for axis, one in known.items() if one and axis in one.estimates}
        report = {axis: axis_report(one, axis) for axis, one in known.items() if one}
        vehicles = with_drag(flight.card, estimates, {axis: one.ci95_flight for axis, one in report.items()})
        widened = {axis: widening(one, report[axis].ci95) for axis, one in estimates.items()}
        known_wind = {
            axis: one
            for axis, one in vehicles.items()
            if tells_wind(report[axis].ci95_flight, is_drag(flight.card, axis))
        }
        damping = {axis: damping_interval(one, widened[axis]) for axis, one in known_wind.items()}
        moving, air, self.courses = courses(flight, vehicles, damping)
        self.doubt = {
            axis: coefficient_error(flight, axis, one, widened[axis])
            for axis, one in known_wind.items()
            if axis in moving
        }
        axes = {
            axis: self._axis(flight, axis, now, known.get(axis), report.get(axis), moving.get(axis))
            for axis in flight.axes
        }
        axes |= {axis: replace(one, state=f"{one.state} (so far {HELD})") for axis, one in axes.items() if axis in held}
        if self._earlier:
            axes = {
                axis: one if axis in self._changed else told_after(one, self._earlier, axis, axis in self._unlike)
                for axis, one in axes.items()
            }
        return Tracked(now, axes, alarms, len(self._bounds) - 1, self._bounds[-1][0], air, self._as_refitted())

    def _as_refitted(self) -> Model | None:
        """The model of the last refits: the same object until the next refit."""
        parts = [group.fitted for group in self._groups.values() if group.fitted]
        fits = tuple(part.fit for part in parts)
        if [id(one) for one in fits] != [id(one) for one in self._model[0]]:
            self._model = fits, together(parts)
        return self._model[1]

    def _axis(
        self,
        flight: Flight,
        axis: str,
        now: float,
        fitted: GroupEstimate | None,
        report: AxisReport | None,
        motion: AxisNow | None,
    ) -> TrackedAxis:
        """What is known of one axis."""
        knowledge, state = _knowledge(flight, axis, now, fitted, report)
        if knowledge == "known":
            self._known[axis] = now
        elif axis in self._known and knowledge != "holding":
            state = f"{state} (known until {self._known[axis]:.0f} s, taken back)"
        structure = fitted.fit.model.axes[axis].structure if fitted else ""
        if axis in self._changed:
            law = self._laws.get(axis, structure)
            if fitted and axis in fitted.estimates and structure != law:
                state = f"{state} (law {structure}, before {law})"
            state = f"changed at {self._changed[axis]:.1f} s, {state}"
        out = TrackedAxis(knowledge, state, watched=self._watched_again().get(axis))
        if fitted and report:
            out = replace(
                out, values=report.values, ci95=report.ci95, ci95_flight=report.ci95_flight, structure=structure
            )
        if motion is None or axis not in self.doubt:
            return out
        return replace(
            out,
            wind=motion.wind,
            wind_ci95=_around(motion.wind, float(np.hypot(motion.wind_error, self.doubt[axis]))),
            gusts=motion.gusts,
            velocity=motion.velocity,
            ahead=motion.ahead,
            ahead_ci95=_around(motion.ahead, motion.ahead_error),
        )


def next_look(due: float, now: float, every: float = EVERY) -> float:
    """Time of the next look or glance, a whole number of periods after one that was due at `due` [s]."""
    return due + every * max(float(np.ceil((now - due) / every + 1e-9)), 1.0)


def _held(group: Group, flight: Flight, now: float) -> tuple[str, ...]:
    """The axes of a group whose commands so far are a position controller's, if its last fit was too short to tell."""
    if group.fitted is None or sum(part.duration for part in group.fitted.fit.flights) > ENOUGH:
        return ()
    part = group.part(flight, group.since, now)
    return restored_axes([part], group.axes, FEW) if part else ()


def _renewed(groups: Mapping[tuple[str, ...], Group], flight: Flight, now: float) -> list[GroupEstimate]:
    """The estimates of groups, unmoved, applied to the flight so far; those of a look at this moment are already."""
    out = []
    for group in groups.values():
        if group.fitted is None:
            continue
        part = group.part(flight, _looks_back(group.since, now), now)
        if part and part.duration >= LEAST_TIME:
            out.append(group.fitted if group.looked == now else renewed(group.fitted, part))
    return out


def _looks_back(since: float, now: float) -> float:
    """Time from which the estimates of a look use the flight [s]: at least `LONGEST` back, in a regime that is so long.

    It moves in steps: what was learnt of the velocity there holds until the next.
    """
    step = BEGINS * LONGEST
    return max(since, step * float(np.floor((now - LONGEST) / step)))


def _knowledge(
    flight: Flight, axis: str, now: float, fitted: GroupEstimate | None, report: AxisReport | None
) -> tuple[Knowledge, str]:
    """The state of knowledge of an axis, in one word and as a phrase."""
    if not commands_axis(flight, axis):
        return "not_excited", UNMOVED
    if fitted is None or report is None:
        return "learning", "learning"
    if axis not in fitted.estimates:
        silent = fitted.fit.model.axes[axis].status["input"] == "not_excited"
        return ("not_excited", "not excited") if silent else ("learning", "learning")
    quiet = _quiet(flight, axis, now)
    if quiet > QUIET:
        return "holding", f"holding (no excitation for {quiet:.0f} s)"
    if all(report.values[name] is not None for name in ("input", "damping", "delay")):
        return "known", "known"
    return "not_identifiable", "not identifiable"


def _around(value: float, error: float) -> Interval:
    return value - NORMAL * error, value + NORMAL * error


def _quiet(flight: Flight, axis: str, now: float) -> float:
    """How long the command of an axis has not changed [s]."""
    u = flight.command[:, AXES.index(axis)]
    new = np.flatnonzero(np.diff(u))
    return now - float(flight.command_time[new[-1] + 1 if new.size else 0])


def _excited(flight: Flight, axes: Sequence[str], since: float, now: float) -> float:
    """Excited time between two instants [s]: at most `QUIET` after each new command of some axes."""
    u = flight.command[:, [AXES.index(axis) for axis in axes]]
    new = flight.command_time[1:][np.any(np.diff(u, axis=0) != 0, axis=1)]
    answered = np.minimum(np.append(new[1:], now), new + QUIET)
    return float(np.maximum(answered - np.maximum(new, since), 0.0).sum())


def _part(flight: Flight, since: float, now: float) -> Flight | None:
    """The flight between two times [s]; None if no segment lies there."""
    if since <= flight.segments[0].start and now >= flight.segments[-1].end:
        return flight
    part = between(flight, since, now)
    return part if part.segments and part.pose_time.size > 1 else None


def scores_of_groups(fitted: Sequence[GroupEstimate], flight: Flight, gusts: int | None = None) -> list[Scores]:
    """The scores of each likelihood of the given groups.

    Args:
        fitted: Their estimates.
        flight: The flight so far.
        gusts: As for `scores_of`.
    """
    return scores_of([part for one in fitted for part in _likelihoods(one)], let_go(flight), gusts)


def _likelihoods(fitted: GroupEstimate) -> list[tuple[Estimates, Doubts]]:
    """The likelihoods of a group, each with the doubts about its laws."""
    by_optimum: dict[int, list[tuple[str, Estimate]]] = {}
    for axis, estimate in fitted.estimates.items():
        by_optimum.setdefault(id(estimate.optimum), []).append((axis, estimate))
    doubts = {axis: doubt_of(fitted.fit.model.axes[axis]) for axis in fitted.estimates}
    return [(each, doubts) for each in by_optimum.values() if each[0][1].records]
