"""The estimates and the regimes of a growing flight, updated by a look once a second.

A look takes an estimation step or a refit for each group of axes (`refits`), tests the last seconds against the rest of
the regime (`changes`), and assembles the state in report and numbers. Between looks, glances only test.

An alarm is raised by the look or glance that finds a change, with the cause that is probable by then. It begins a new
regime. A second later the cause is named again, from the estimates before the change and more data, and the alarm is
revised: its regime is then as if it had been raised like that. Only then it says by how much: in a fraction of a second
the size of a change and its time explain each other, and no interval of either alone holds.
"""

from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, replace
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
from rotorfit.estimation.zero_command import late_by
from rotorfit.files.models import from_mapping, to_mapping
from rotorfit.tracking.air import AxisNow, Course, courses, doubts_of
from rotorfit.tracking.alarms import (
    alarm_of,
    diagnosed,
    is_same,
    joined_alarm,
    odds_of_pushes,
    rarest,
    seen_in_z_or_yaw,
    sizes,
    with_sizes,
)
from rotorfit.tracking.beside_earlier import BesideEarlier
from rotorfit.tracking.changes import (
    LEAST_CHUNKS,
    NEW,
    Contrast,
    begun_within,
    calm,
    earliest,
    likeliest,
    likeliest_begun,
    looked_together,
)
from rotorfit.tracking.drag import damping_interval, is_drag, tells_wind, widening, with_drag
from rotorfit.tracking.earlier import SHARE, Earlier
from rotorfit.tracking.excited_time import QUIET
from rotorfit.tracking.faults import checked, faults_after, last_turn, turns_of, with_faults
from rotorfit.tracking.groups import (
    Group,
    held_axes,
    looks_back,
    new_excited_time,
    quiet_for,
    recent_groups,
    scores_of_groups,
)
from rotorfit.tracking.instant import changed_when
from rotorfit.tracking.refits import (
    REFIT,
    AxisReport,
    GroupEstimate,
    axis_report,
    believed_laws,
    grown,
    growth,
    refitted,
    renewed,
    stepped,
    together,
)
from rotorfit.tracking.regimes import Bounds, fading, learnt_from, model_of_own, regimes_of
from rotorfit.tracking.scores import CHUNK, WINDOWS
from rotorfit.tracking.watch import Watch
from rotorfit.tracking.wind_error import Doubt

EVERY, GLANCE = 1.0, 0.25
"""Time between looks, and between glances [s]."""

SHORT = tuple(window for window in WINDOWS if window <= 16 * GLANCE)
"""Lengths of the windows that a glance tests [s]: in a longer one little is new since the last look."""

REVISED = 1.0
"""Time from an alarm to its revision [s]."""

SAGS = 10.0
"""Time for which a revision waits while the vehicle may have touched down [s]."""

JOINS, JOINING = 1e-5, 20.0
"""p-value below which another axis changed with those of an alarm, and for how long after it that is asked [s]. Its
instant is known, so that no window is chosen; that an alarm is true has been shown before."""

FALSE_ALARMS_PER_HOUR = 0.1
"""Promised rate of false alarms by default [1/h]."""

RESTLESS = 0.97
"""Commanded share of a regime above which the vehicle's behaviour at rest cannot explain a change."""

STRONG = 3.0
"""Log-odds that count as strong evidence (R. E. Kass, A. E. Raftery, J. Amer. Statist. Assoc. 90 (1995), pp. 773-795,
section 3.2)."""

HELD = "its commands only answer its motion"


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
    bounds: Bounds
    groups: Mapping[tuple[str, ...], Group]


@dataclass(frozen=True)
class _BeforeSinking:
    """What was known before the vehicle may have touched down: a payload under which it sinks is learnt meanwhile.

    Attributes:
        since, until: When it first and last may have touched down [s].
        groups: Groups of axes, as estimated before.
    """

    since: float
    until: float
    groups: Mapping[tuple[str, ...], Group]


@dataclass(frozen=True)
class _Raised:
    """An alarm that will be, or was, revised.

    Attributes:
        alarm: The alarm.
        found: When the contrast was found [s].
        names: Names of the scores of the likelihood that shows the change.
        contrast: Its contrast.
        p_value: That of the contrast, in any air.
        looked: All contrasts of that look, by the names of their scores.
        before: What was known before.
    """

    alarm: Alarm
    found: float
    names: tuple[str, ...]
    contrast: Contrast
    p_value: float
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
        self._false_alarms = false_alarms_per_hour * (1.0 - SHARE if earlier else 1.0)
        self._groups: dict[tuple[str, ...], Group] = {}
        self._since = dict.fromkeys(AXES, 0.0)
        self._changed: dict[str, float] = {}
        self._laws: dict[str, str] = {}
        self._known: dict[str, float] = {}
        self._raised: _Raised | None = None
        self._told: _Raised | None = None  # the alarm that was revised last
        self._findings: tuple[Finding, ...] | None = None
        self._shown: tuple[Model | None, tuple[Finding, ...] | None, Model | None] = (None, None, None)
        self._suspected: float | None = None
        self._sinking: _BeforeSinking | None = None
        self._watch = Watch()
        self._bounds: list[tuple[float, Alarm | None]] = [(0.0, None)]
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
        alarm = self._change(flight, now, standing, SHORT)
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
        alarm = self._change(flight, now, standing)
        if not self._suspects(now):
            self._groups = {axes: self._looked(axes, flight, now) for axes in groups_of([flight], flight.axes)}
        if self._findings is None or self._as_refitted() is not before:
            self._findings = checked(flight, turns_of(self._bounds), now)
        state = self._tracked(flight, now, (alarm,) if alarm else ())
        if self._earlier and not alarm and self._as_refitted() is not before:
            unlike = self._earlier.another_vehicle(state, self._changed)
            return self._tracked(flight, now, (unlike,)) if unlike else state  # anew, without the earlier numbers
        return state

    def memory(self) -> dict[str, Any]:
        """Regimes and the time of the next look, as plain types; `recall` leaves the estimates to new fits.

        Models of regimes whose seconds are forgotten are part of it.
        """
        bounds = [(since, asdict(alarm) if alarm else None) for since, alarm in self._bounds]
        kept = [(start, model and to_mapping(model)) for start, model in self._kept.items()]
        told = {"kept": kept, "watched": dict(self._watch.since), **(self._earlier.memory() if self._earlier else {})}
        since = {"since": dict(self._since), "changed": dict(self._changed), "laws": dict(self._laws)}
        return {**since, "bounds": bounds, "next_look": float(self.next_look), "begins": self._begins, **told}

    def recall(self, memory: Mapping[str, Any]) -> None:
        """Continues from what `memory` returned."""
        self._since, self._changed = dict(memory["since"]), dict(memory["changed"])
        self._laws = dict(memory.get("laws", {}))
        self.next_look = memory["next_look"]
        self._bounds = [(since, alarm_from_mapping(alarm) if alarm else None) for since, alarm in memory["bounds"]]
        self._kept = {
            start: model and from_mapping(model, "the state of the tracker") for start, model in memory.get("kept", ())
        }
        self._watch.since, self._begins = dict(memory.get("watched", {})), memory.get("begins", np.inf)
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
        regimes, last = regimes_of(flight, self._bounds, groups, self._structure, now, self._begins, self._kept)
        known = {axes: self._groups.get(axes, Group(axes, max(self._since[axis] for axis in axes))) for axes in groups}
        self._groups = {axes: replace(one, fitted=last.get(axes, one.fitted)) for axes, one in known.items()}
        end = flight.segments[-1].end
        turns = turns_of(self._bounds)
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
        for start in fading(flight, self._bounds, self._begins, groups):
            if start not in self._kept:
                model = model_of_own(flight, self._bounds, groups, self._structure, start)
                turns = turns_of(self._bounds)
                faults = faults_after(flight, turns, last_turn(turns, start))
                self._kept[start] = with_faults(model, flight, turns, faults)

    def _jumped(self, alarm: Alarm) -> None:
        """Begins a regime for x and y where the heading jumped: nobody knows along which directions they act now.

        An alarm that was not revised stays as it is: its revision would go back to before the jump.
        """
        if alarm.turned:
            self._raised, self._told, self._findings = None, None, None
            before = _Before(self._since, self._changed, self._bounds, self._groups)
            self._begin(replace(alarm, axes=("x", "y")), alarm.since[1], before)

    def _looked(self, axes: tuple[str, ...], flight: Flight, now: float) -> Group:
        """A group after this look."""
        since = max(self._since[axis] for axis in axes)
        group = self._groups.get(axes, Group(axes, since))
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

    def _change(self, flight: Flight, now: float, standing: bool, lengths: Sequence[float] = WINDOWS) -> Alarm | None:
        """The alarm that is raised or revised now, if there is one; it begins a new regime.

        Args:
            flight: As in `look`.
            now: As in `look`.
            standing: As in `look`.
            lengths: Lengths of the windows that are tested [s].
        """
        raised, self._raised = self._raised, None
        suspected, self._suspected = self._suspected, None
        if standing:  # a vehicle that sags under a payload is flown on, one that lands may be another one afterwards
            self._raised = raised if raised and now < raised.found + SAGS else None
            self._sinking = (
                replace(self._sinking, until=now) if self._sinking else _BeforeSinking(now, now, self._groups)
            )
            return None
        if self._sinking and now > self._sinking.until + NEW:
            self._sinking = None
        groups: Mapping[tuple[str, ...], Group] = self._sinking.groups if self._sinking else self._groups
        back = NEW + (min(now - self._sinking.since, SAGS) if self._sinking else 0.0)
        if raised and now < raised.found + REVISED - 1e-6:
            self._raised = raised
            return None
        if raised:
            return self._revision(flight, now, raised)
        if all(now - group.since < (LEAST_CHUNKS - 1) * CHUNK for group in groups.values()):
            return None  # no window has a rest that is long enough
        known = recent_groups(groups, flight, now)
        scored = {scores.names: scores for scores in scores_of_groups(known, flight)}
        looked, count = looked_together(list(scored.values()), lengths, back)
        threshold = self._false_alarms * GLANCE / 3600.0 / max(count, 1)
        self._watch.note(scored, lengths, now, self._alarms())
        found = rarest(known, flight, looked, lengths, back, threshold)
        if not found:
            self._raised = self._joined(flight, now) if lengths == WINDOWS else None
            return None
        names, first, p_value = found
        best = likeliest(scored[names], first, looked[names])
        when, since = changed_when(scored[names], earliest(scored[names], first))
        earlier = min(since[0], best.since)
        if not calm(scored[names], earlier, best.since, p_value):
            self._suspected = suspected or now
            return None  # the air, not the vehicle
        change = flight, now, groups, names, earlier, threshold
        if (not seen_in_z_or_yaw(looked, first) and self._at_rest(*change)) or self._under_another_law(*change):
            self._suspected = suspected or now  # a change that is barely seen may show in the answers a moment later
            return None  # the vehicle has not changed: it obeys another law at rest, or another than was held so far
        if self._told and is_same(self._told.alarm, since, now):
            self._raised = replace(self._told, found=now, names=names, contrast=first, p_value=p_value, looked=looked)
            return None  # nothing new, but more of it
        odds = odds_of_pushes(scored, since) if best.jolt else np.inf
        named = diagnosed(scored, names, [best], looked, {}, odds)
        alarm = alarm_of(flight, now, named, since, p_value)
        before = _Before(self._since, self._changed, self._bounds, groups)
        self._raised = _Raised(alarm, now, names, first, p_value, looked, before)
        self._begin(alarm, when, before)
        return alarm

    def _joined(self, flight: Flight, now: float) -> _Raised | None:
        """The last alarm by another likelihood, by which axes that it did not name changed at its instant, too."""
        told = self._told
        if told is None or not told.alarm.raised + REVISED < now < told.alarm.raised + JOINING:
            return None
        groups = {axes: one for axes, one in told.before.groups.items() if not set(axes) & set(told.alarm.axes)}
        for scores in scores_of_groups(recent_groups(groups, flight, now), flight):
            one = likeliest_begun(begun_within(scores, told.alarm.since))
            if one and one.p_value < JOINS and calm(scores, told.alarm.since[0], one.since, one.p_value):
                return replace(told, found=now, names=scores.names, contrast=one, p_value=one.p_value, looked={})
        return None

    def _revision(self, flight: Flight, now: float, raised: _Raised) -> Alarm | None:
        """The alarm in place of one that was raised, from the estimates before it and the data until `REVISED` after.

        It begins the regime anew.
        """
        groups = recent_groups(raised.before.groups, flight, min(now, raised.found + REVISED))
        scores = scores_of_groups(groups, flight)
        scored = {one.names: one for one in scores}
        if raised.names not in scored:
            return None
        here, first = scored[raised.names], raised.contrast
        looked, _ = looked_together(scores)
        best = likeliest(here, first, looked[raised.names])
        when, since = changed_when(here, earliest(here, first))
        odds = odds_of_pushes(scored, since) if best.jolt else np.inf
        begun = begun_within(here, since) if not best.jolt or odds < -STRONG else []
        named = diagnosed(scored, raised.names, begun or [best], looked, raised.looked, odds)
        best = likeliest_begun(begun) or best
        change = sizes(named, scored, since, best.since)
        alarm = with_sizes(alarm_of(flight, now, named, since, raised.p_value), named, change, raised.alarm.raised)
        if self._told and self._told.alarm.raised == alarm.raised:
            alarm = joined_alarm(self._told.alarm, alarm, {name.partition(".")[0] for name in raised.names})
        self._told = replace(raised, alarm=alarm)
        self._begin(alarm, when, raised.before)
        return alarm

    def _alarms(self) -> list[Alarm]:
        """Those raised so far, in the order of their changes."""
        return [alarm for _, alarm in self._bounds if alarm]

    def _suspects(self, now: float) -> bool:
        """Whether a change may have come that only the air speaks against: what is learnt of it would hide it."""
        return self._suspected is not None and now < self._suspected + NEW

    def _begin(self, alarm: Alarm, when: float, before: _Before) -> None:
        """Begins a regime for the axes of an alarm; an axis that only its first version named is as it was before."""
        self._sinking = None
        self._known = {axis: time for axis, time in self._known.items() if axis not in alarm.axes}
        self._since = {**before.since, **{axis: learnt_from(alarm, (axis,)) for axis in alarm.axes}}
        self._changed = {**before.changed, **dict.fromkeys(alarm.axes, when)}
        self._bounds = sorted([*before.bounds, (when, alarm)], key=lambda bound: bound[0])
        groups = dict(self._groups)
        for axes, group in groups.items():
            known = before.groups.get(axes, group)
            if known.fitted:
                laws = {axis: known.fitted.fit.model.axes[axis].structure for axis in known.fitted.estimates}
                self._laws |= {axis: law for axis, law in laws.items() if axis in alarm.axes}
            if set(axes) & set(alarm.axes):
                groups[axes] = Group(axes, learnt_from(alarm, axes), answers=group.answers)
            elif group.since != known.since:
                groups[axes] = known
        self._groups = groups

    def _at_rest(
        self,
        flight: Flight,
        now: float,
        groups: Mapping[tuple[str, ...], Group],
        names: Sequence[str],
        before: float,
        threshold: float,
    ) -> bool:
        """Whether a change was only found because x and y obey another law at rest: many vehicles brake or hold there.

        That is so if their answers to commands show none when fitted alone, up to the time `before` the change [s] if
        that is long enough; from then on they are.
        """
        for axes, group in groups.items():
            if group.fitted is None or group.answers is not None or set(axes) & {"z", "yaw"}:
                continue
            if not any(name.split(".")[0] in axes for name in names):
                continue
            late = [late_by(one) for one in group.fitted.estimates.values()]
            apart = replace(group, answers=min(late))
            begin = looks_back(flight, axes, group.since, now)
            whole, answers = (one.part(flight, begin, now) for one in (group, apart))
            if not (whole and answers and LEAST_TIME <= answers.duration <= RESTLESS * whole.duration):
                continue
            first = apart.part(flight, begin, before)
            part = first if first and first.duration >= LEAST_TIME else answers
            apart = replace(apart, fitted=refitted(part, axes, self._structure, group.fitted.seen))
            if _shows_nothing({axes: apart}, flight, now, threshold):
                self._hold(apart)
                return True
        return False

    def _under_another_law(
        self,
        flight: Flight,
        now: float,
        groups: Mapping[tuple[str, ...], Group],
        names: Sequence[str],
        before: float,
        threshold: float,
    ) -> bool:
        """Whether a change was only found because one law is held where the flight before could not tell which holds.

        A lag that turns with the vehicle and one that keeps its direction are the same until it turns. So a change must
        be one under each believed law, fitted up to the time `before` the change [s]. From then on the law is held that
        shows none, until the next look weighs all of them anew.
        """
        for axes, group in groups.items():
            if group.fitted is None or not any(name.split(".")[0] in axes for name in names):
                continue
            part = group.part(flight, looks_back(flight, axes, group.since, now), before)
            if part is None or part.duration < LEAST_TIME:
                continue
            for law in believed_laws(group.fitted):
                fitted = refitted(part, axes, law, seen=0.0)
                other = replace(group, fitted=fitted)
                if fitted.estimates and _shows_nothing({**groups, axes: other}, flight, now, threshold):
                    self._hold(other)
                    return True
        return False

    def _hold(self, group: Group) -> None:
        """Another estimate of a group from now on."""
        self._groups[group.axes] = group
        if self._sinking:
            self._sinking = replace(self._sinking, groups={**self._sinking.groups, group.axes: group})

    def _tracked(self, flight: Flight, now: float, alarms: tuple[Alarm, ...]) -> Tracked:
        """The state in words and numbers."""
        held = {axis for group in self._groups.values() for axis in held_axes(group, flight, now)}
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
        doubts = doubts_of(flight, vehicles, widened, moving)
        self.doubt = {axis: doubts[axis] for axis in known_wind if axis in doubts}
        axes = {
            axis: self._axis(flight, axis, now, known.get(axis), report.get(axis), moving.get(axis))
            for axis in flight.axes
        }
        axes |= {axis: replace(one, state=f"{one.state} (so far {HELD})") for axis, one in axes.items() if axis in held}
        if self._earlier:
            axes = self._earlier.told(axes, self._changed)
        model, findings = self._with_findings(flight), self._findings
        return Tracked(now, axes, alarms, len(self._bounds) - 1, self._bounds[-1][0], air, model, findings=findings)

    def _with_findings(self, flight: Flight) -> Model | None:
        """The model of the last refits with the faults of the data: the same object until one of the two is another."""
        model, findings, _ = self._shown
        if model is not self._as_refitted() or findings is not self._findings:
            model, findings = self._as_refitted(), self._findings
            self._shown = model, findings, with_faults(model, flight, turns_of(self._bounds), findings or ())
        return self._shown[2]

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
        out = TrackedAxis(knowledge, state, watched=self._watch.again(self._alarms()).get(axis))
        if seen := self._watch.of(axis):
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


def _shows_nothing(groups: Mapping[tuple[str, ...], Group], flight: Flight, now: float, threshold: float) -> bool:
    """Whether a look at groups finds no contrast with a p-value below a threshold, and at least tests for one."""
    looked, _ = looked_together(scores_of_groups(recent_groups(groups, flight, now), flight))
    return bool(looked) and not any(one.p_value < threshold for each in looked.values() for one in each)


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
