"""The estimates and the regimes of a growing flight, updated by a look once a second.

A look takes an estimation step or a refit for each group of axes (`refits`), tests the last seconds against the rest of
the regime (`change_watch`), and assembles the state in report and numbers. Between looks, glances only test.
"""

from collections.abc import Mapping, Sequence
from dataclasses import asdict, replace
from typing import Any

import numpy as np

from rotorfit.core.finding import Finding
from rotorfit.core.flight_data import Flight
from rotorfit.core.frames import AXES
from rotorfit.core.laws import AVERAGED
from rotorfit.core.model import NORMAL, Interval, Model
from rotorfit.core.results import Fit
from rotorfit.core.tracked import UNMOVED, Alarm, Knowledge, Regime, Tracked, TrackedAxis, alarm_from_mapping
from rotorfit.estimation.grouping import commands_axis, groups_of
from rotorfit.estimation.identifiability import LEAST_TIME
from rotorfit.estimation.likelihood.optima import between
from rotorfit.files.models import from_mapping, to_mapping
from rotorfit.tracking.air import AxisNow, Course, courses, doubts_of
from rotorfit.tracking.beside_earlier import BesideEarlier
from rotorfit.tracking.change_watch import GLANCE, ChangeWatch
from rotorfit.tracking.drag import damping_interval, is_drag, tells_wind, widening, with_drag
from rotorfit.tracking.earlier import SHARE, Earlier
from rotorfit.tracking.excited_time import QUIET
from rotorfit.tracking.faults import checked, faults_after, last_turn, turns_of, with_faults
from rotorfit.tracking.groups import Group, held_axes, looks_back, new_excited_time, quiet_for
from rotorfit.tracking.learnt import NOTHING_LEARNT, Learnt, after_change
from rotorfit.tracking.refits import (
    REFIT,
    AxisReport,
    GroupEstimate,
    axis_report,
    grown,
    growth,
    refitted,
    renewed,
    stepped,
    together,
)
from rotorfit.tracking.regimes import fading, model_of_own, regimes_of
from rotorfit.tracking.scores import WINDOWS
from rotorfit.tracking.wind_error import Doubt

EVERY = 1.0
"""Time between looks [s]."""

SHORT = tuple(window for window in WINDOWS if window <= 16 * GLANCE)
"""Lengths of the windows that a glance tests [s]: in a longer one little is new since the last look."""

FALSE_ALARMS_PER_HOUR = 0.1
"""Promised rate of false alarms by default [1/h]."""

HELD = "its commands only answer its motion"


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
        learnt: Regimes and estimates after the last look or glance.
        courses: Motion filters of the last look, ready to be continued.
        doubt: Axis name to the errors of its motion due to the coefficients.
    """

    def __init__(
        self,
        structure: str = AVERAGED,
        false_alarms_per_hour: float = FALSE_ALARMS_PER_HOUR,
        earlier: Earlier | None = None,
        tuned: bool = False,
    ) -> None:
        self._structure, self._often = structure, tuned or earlier is not None
        self._earlier = BesideEarlier(earlier, false_alarms_per_hour) if earlier else None
        self._changes = ChangeWatch(structure, false_alarms_per_hour * (1.0 - SHARE if earlier else 1.0))
        self.learnt = NOTHING_LEARNT
        self._findings: tuple[Finding, ...] | None = None
        self._shown: tuple[Model | None, tuple[Finding, ...] | None, Model | None] = (None, None, None)
        self._model: tuple[tuple[Fit, ...], Model | None] = ((), None)
        self._begins = np.inf
        self._kept: dict[float, Model | None] = {}
        self.next_look = LEAST_TIME
        self.courses: tuple[Course, ...] = ()
        self.doubt: dict[str, Doubt] = {}

    def follow(
        self, flight: Flight, now: float, standing: bool = False, alarms: tuple[Alarm, ...] = ()
    ) -> Tracked | None:
        """A look at the flight so far, if one is due; else a glance. See both.

        Args:
            flight: As in `look`.
            now: As in `look`.
            standing: As in `look`.
            alarms: Those of the pose itself since the last call; the state tells them first.
        """
        for alarm in alarms:
            self._jumped(alarm)
        state = (self.look if now > self.next_look - 1e-6 else self.glance)(flight, now, standing)
        if not alarms:
            return state
        state = state or self._tracked(flight, now, ())
        return replace(state, alarms=(*alarms, *state.alarms))

    def glance(self, flight: Flight, now: float, standing: bool = False) -> Tracked | None:
        """Tests whether the vehicle has changed, without a step of the estimates; None if there is no alarm.

        Args:
            flight: As in `look`.
            now: As in `look`.
            standing: As in `look`.
        """
        alarm = self._tested(flight, now, standing, SHORT)
        return self._tracked(flight, now, (alarm,)) if alarm else None

    def look(self, flight: Flight, now: float, standing: bool = False) -> Tracked:
        """A look at the flight so far.

        Args:
            flight: Its samples up to now.
            now: Time of the look [s].
            standing: Whether the vehicle stands, may touch down, or takes off or lands by itself: then no change is
                tested for.

        Returns:
            The state, with the alarms of this look.
        """
        self.next_look = next_look(self.next_look, now)
        self._keep(flight)
        before = self._as_refitted()
        alarm = self._tested(flight, now, standing, WINDOWS)
        if not self._changes.suspects(now):
            groups = {axes: self._looked(axes, flight, now) for axes in groups_of([flight], flight.axes)}
            self.learnt = replace(self.learnt, groups=groups)
        if self._findings is None or self._as_refitted() is not before:
            self._findings = checked(flight, turns_of(self.learnt.bounds), now)
        state = self._tracked(flight, now, (alarm,) if alarm else ())
        if self._earlier and not alarm and self._as_refitted() is not before:
            unlike = self._earlier.another_vehicle(state, self.learnt.changed)
            return self._tracked(flight, now, (unlike,)) if unlike else state  # anew, without the earlier numbers
        return state

    def memory(self) -> dict[str, Any]:
        """Regimes and the time of the next look, as plain types; `recall` leaves the estimates to new fits.

        Models of regimes whose seconds are forgotten are part of it.
        """
        bounds = [(since, asdict(alarm) if alarm else None) for since, alarm in self.learnt.bounds]
        kept = [(start, model and to_mapping(model)) for start, model in self._kept.items()]
        told = {"kept": kept, "watched": dict(self._changes.watched.since)}
        told |= self._earlier.memory() if self._earlier else {}
        learnt = self.learnt
        since = {"since": dict(learnt.since), "changed": dict(learnt.changed), "laws": dict(learnt.laws)}
        return {**since, "bounds": bounds, "next_look": float(self.next_look), "begins": self._begins, **told}

    def recall(self, memory: Mapping[str, Any]) -> None:
        """Continues from what `memory` returned."""
        self.learnt = Learnt(
            since=dict(memory["since"]),
            changed=dict(memory["changed"]),
            laws=dict(memory.get("laws", {})),
            bounds=[(since, alarm_from_mapping(alarm) if alarm else None) for since, alarm in memory["bounds"]],
            known={},
            groups={},
        )
        self.next_look = memory["next_look"]
        self._kept = {
            start: model and from_mapping(model, "the state of the tracker") for start, model in memory.get("kept", ())
        }
        self._changes.watched.since, self._begins = dict(memory.get("watched", {})), memory.get("begins", np.inf)
        if self._earlier:
            self._earlier.recall(memory)

    def finish(self, flight: Flight, now: float, alarms: tuple[Alarm, ...] = ()) -> tuple[Tracked, tuple[Regime, ...]]:
        """The final state, after a last fit of each group, and the regimes with their models.

        The model of the last regime is that of the final state. Wind and motion are those of the last moment that
        counts: a vehicle that has landed is held up by the ground, which no command explains either.

        Args:
            flight: The flight, as far as it is remembered.
            now: Its end [s].
            alarms: Those of the pose itself since the last look or glance.
        """
        for alarm in alarms:
            self._jumped(alarm)
        groups = groups_of([flight], flight.axes) or [AXES]
        self._keep(flight)
        bounds, turns = self.learnt.bounds, turns_of(self.learnt.bounds)
        regimes, last = regimes_of(flight, bounds, groups, self._structure, now, self._begins, self._kept)
        known = {axes: self.learnt.group(axes) for axes in groups}
        known = {axes: replace(one, fitted=last.get(axes, one.fitted)) for axes, one in known.items()}
        self.learnt = replace(self.learnt, groups=known)
        end = flight.segments[-1].end
        faults = {turn: faults_after(flight, turns, turn) for turn in (-np.inf, *turns)}
        self._findings = faults[last_turn(turns, now)]
        state = replace(self._tracked(between(flight, 0.0, end), end, alarms), time=now, landed=True)
        told = [with_faults(one.model, flight, turns, faults[last_turn(turns, one.start)]) for one in regimes]
        return state, tuple(
            one if one.start in self._kept else replace(one, model=model)
            for one, model in zip(regimes, told, strict=True)
        )

    def _keep(self, flight: Flight) -> None:
        """Fits the regimes that begin to be forgotten."""
        self._begins = min(self._begins, flight.span[0])
        groups = groups_of([flight], flight.axes)
        bounds, turns = self.learnt.bounds, turns_of(self.learnt.bounds)
        for start in fading(flight, bounds, self._begins, groups):
            if start not in self._kept:
                model = model_of_own(flight, bounds, groups, self._structure, start)
                faults = faults_after(flight, turns, last_turn(turns, start))
                self._kept[start] = with_faults(model, flight, turns, faults)

    def _jumped(self, alarm: Alarm) -> None:
        """Begins a regime for x and y where the heading jumped: nobody knows along which directions they act now.

        An alarm that was not revised stays as it is: its revision would go back to before the jump.
        """
        if alarm.turned:
            self._changes.begin_anew()
            self._findings = None
            plane = replace(alarm, axes=("x", "y"))
            self.learnt = after_change(self.learnt, self.learnt, plane, alarm.since[1])

    def _looked(self, axes: tuple[str, ...], flight: Flight, now: float) -> Group:
        """A group after this look."""
        group, since = self.learnt.group(axes), self.learnt.since_of(axes)
        if group.since != since:
            group = Group(axes, since, answers=group.answers)
        part = group.part(flight, looks_back(flight, axes, since, now), now)
        if part is None or part.duration < LEAST_TIME:
            return group
        excited = group.excited + new_excited_time(group, flight, now)
        group, before = replace(group, excited=excited, looked=now), group.fitted
        if before and all(quiet_for(flight, axis, now) > QUIET for axis in axes):
            return replace(group, fitted=renewed(before, part))  # no excitation: the last values hold
        if before is None or grown(before.seen, excited, REFIT if before.estimates and self._often else growth(before)):
            return replace(group, fitted=refitted(part, axes, self._structure, excited))
        return replace(group, fitted=stepped(before, part, excited))

    def _tested(self, flight: Flight, now: float, standing: bool, lengths: Sequence[float]) -> Alarm | None:
        """The alarm of a test of windows of some lengths, if there is one; it begins a regime."""
        alarm, self.learnt = self._changes.test(self.learnt, flight, now, standing, lengths)
        return alarm

    def _tracked(self, flight: Flight, now: float, alarms: tuple[Alarm, ...]) -> Tracked:
        """The state in words and numbers."""
        held = {axis for group in self.learnt.groups.values() for axis in held_axes(group, flight, now)}
        fitted = ((axis, one.fitted) for axes, one in self.learnt.groups.items() for axis in axes)
        known = {axis: None if axis in held else one for axis, one in fitted}
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
        doubts = doubts_of(flight, vehicles, widened, moving)
        self.doubt = {axis: doubts[axis] for axis in known_wind if axis in doubts}
        axes = {
            axis: self._axis(flight, axis, now, known.get(axis), report.get(axis), moving.get(axis))
            for axis in flight.axes
        }
        known_now = {axis: now for axis, one in axes.items() if one.knowledge == "known"}
        self.learnt = replace(self.learnt, known={**self.learnt.known, **known_now})
        axes |= {axis: replace(one, state=f"{one.state} (so far {HELD})") for axis, one in axes.items() if axis in held}
        if self._earlier:
            axes = self._earlier.told(axes, self.learnt.changed)
        model, findings = self._with_findings(flight), self._findings
        bounds = self.learnt.bounds
        return Tracked(now, axes, alarms, len(bounds) - 1, bounds[-1][0], air, model, findings=findings)

    def _with_findings(self, flight: Flight) -> Model | None:
        """The model of the last refits with the faults of the data: the same object until one of the two is another."""
        model, findings, _ = self._shown
        if model is not self._as_refitted() or findings is not self._findings:
            model, findings = self._as_refitted(), self._findings
            self._shown = model, findings, with_faults(model, flight, turns_of(self.learnt.bounds), findings or ())
        return self._shown[2]

    def _as_refitted(self) -> Model | None:
        """The model of the last refits: the same object until the next refit."""
        parts = [group.fitted for group in self.learnt.groups.values() if group.fitted]
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
        if axis in self.learnt.known and knowledge not in ("known", "holding"):
            state = f"{state} (known until {self.learnt.known[axis]:.0f} s, taken back)"
        structure, watched = fitted.fit.model.axes[axis].structure if fitted else "", self._changes.watched
        if axis in self.learnt.changed:
            law = self.learnt.laws.get(axis, structure)
            if fitted and axis in fitted.estimates and structure != law:
                state = f"{state} (law {structure}, before {law})"
            state = f"changed at {self.learnt.changed[axis]:.1f} s, {state}"
        out = TrackedAxis(knowledge, state, watched=watched.since_alarms(self.learnt.alarms).get(axis))
        if seen := watched.of(axis):
            out = replace(out, untested=seen.lately, untested_in_all=seen.untested / seen.rows)
        if fitted and report:
            out = replace(
                out, values=report.values, ci95=report.ci95, ci95_flight=report.ci95_flight, structure=structure
            )
        doubt = self.doubt.get(axis)
        if motion is None or doubt is None:
            return out
        return replace(
            out,
            wind=motion.wind,
            wind_ci95=_around(motion.wind, float(np.hypot(motion.wind_error, doubt.wind))),
            gusts=motion.gusts,
            velocity=motion.velocity,
            ahead=motion.ahead,
            ahead_ci95=_around(motion.ahead, float(np.hypot(motion.ahead_error, doubt.ahead))),
        )


def next_look(due: float, now: float, every: float = EVERY) -> float:
    """Time of the next look or glance, a whole number of periods after one that was due at `due` [s]."""
    return due + every * max(float(np.ceil((now - due) / every + 1e-9)), 1.0)


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
    quiet = quiet_for(flight, axis, now)
    if quiet > QUIET:
        return "holding", f"holding (no excitation for {quiet:.0f} s)"
    if all(report.values[name] is not None for name in ("input", "damping", "delay")):
        return "known", "known"
    return "not_identifiable", "not identifiable"


def _around(value: float, error: float) -> Interval:
    return value - NORMAL * error, value + NORMAL * error
