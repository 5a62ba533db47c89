"""Tracker: samples in, and at any moment what is known of the vehicle; the flight so far is all that it remembers.

Every sample goes into the growing flight and costs no more than that. Once a second (`look`) the estimates of all axes
take a step, the last seconds are compared with the rest, and the state is put together. It never commands a vehicle.
"""

import json
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, replace
from typing import Any

import numpy as np

from rotorfit.core.card import Card
from rotorfit.core.flight_data import Flight
from rotorfit.core.frames import AXES
from rotorfit.core.laws import AVERAGED
from rotorfit.core.log import Sample
from rotorfit.core.model import Interval, Model
from rotorfit.core.results import Fit
from rotorfit.core.tracked import Alarm, Knowledge, Regime, Tracked, TrackedAxis, alarm_from_mapping
from rotorfit.estimation.fitting import fit
from rotorfit.estimation.grouping import commands_axis, groups_of
from rotorfit.estimation.identifiability import LEAST_TIME, NORMAL
from rotorfit.estimation.likelihood.axis_estimate import Estimate
from rotorfit.estimation.likelihood.optima import between
from rotorfit.tracking.air import AxisMotion, motion_now
from rotorfit.tracking.causes import diagnosis
from rotorfit.tracking.changes import Contrast, Scores, at_once, calm, looked_for, looks, scores_of, since_when
from rotorfit.tracking.earlier import SHARE, Earlier, another_vehicle, check_earlier, compared, until_known
from rotorfit.tracking.following import (
    REFIT,
    SILENT,
    Followed,
    Said,
    doubt_of,
    followed_of,
    refitted,
    renewed,
    said,
    stepped,
    together,
)
from rotorfit.tracking.growing_flight import GrowingFlight
from rotorfit.tracking.wind_error import coefficient_error, tells_wind, wider

EVERY = 1.0
"""Time between looks [s]."""

LONGEST = 300.0
"""Time that an estimate looks back over [s]: of a longer regime the oldest part is left to itself."""

QUIET = 5.0
"""Time without a new command after which an axis holds [s]: by then it has answered the last."""

FALSE_ALARMS_PER_HOUR, MOST_FALSE_ALARMS = 0.1, 60.0
"""Promised by default, and the most that can be asked for: one a minute."""


@dataclass(frozen=True)
class Group:
    """Axes that are fitted together, since when, and what is known of them; None before the first fit."""

    axes: tuple[str, ...]
    since: float
    followed: Followed | None = None


@dataclass(frozen=True)
class _Seen:
    """A change that was seen at the last look and is named at this one: which likelihood, as what, what else."""

    names: tuple[str, ...]
    contrast: Contrast
    looked: Mapping[tuple[str, ...], Sequence[Contrast]]


class Tracker:
    """Follows one vehicle.

    Args:
        card: Meaning of commands and poses.
        structure: As `fit` takes it.
        false_alarms_per_hour: The expected number that is promised not to be passed.
        origin: Stamp of second 0 of the flight [ns]; by default that of the first sample.
        after: The model of an earlier flight of the vehicle: what it was, until this flight tells.

    Raises:
        TypeError: The card is none.
        ValueError: A number of false alarms that cannot be promised.
        CardError: Commands mean something else to the earlier model.
    """

    def __init__(
        self,
        card: Card,
        structure: str = AVERAGED,
        false_alarms_per_hour: float = FALSE_ALARMS_PER_HOUR,
        origin: int | None = None,
        after: Model | Earlier | None = None,
    ) -> None:
        if not isinstance(card, Card):
            raise TypeError(f"a Card is wanted, not {type(card).__name__}: rotorfit.load_card loads one")
        if not 0 < false_alarms_per_hour <= MOST_FALSE_ALARMS:
            raise ValueError(f"false alarms an hour are above 0 and at most {MOST_FALSE_ALARMS:g}")
        self._growing = GrowingFlight(card, origin)
        earlier = Earlier(after) if isinstance(after, Model) else after
        if earlier:
            check_earlier(earlier, card)
        self._following = Following(structure, false_alarms_per_hour, earlier)
        begin = TrackedAxis()
        axes = {axis: until_known(begin, earlier, axis) if earlier else begin for axis in AXES}
        self._state = Tracked(0.0, axes)

    def update(self, sample: Sample) -> None:
        """Takes a sample: a pose, or a command as it was sent."""
        took, now = self._growing.add(sample), self._growing.now
        alarms = self._growing.alarms()
        if took and now >= self._following.next_look:
            self._look(now, alarms)
        elif alarms:
            self._state = replace(self._state, time=now, alarms=alarms)

    def _look(self, now: float, alarms: tuple[Alarm, ...]) -> None:
        """A look; what the pose raised by itself in the same instant stands before its alarms."""
        if flight := self._growing.flight():
            state = self._following.look(flight, now, self._growing.standing)
            self._state = replace(state, alarms=(*alarms, *state.alarms))
            return
        self._following.next_look = now + EVERY
        if alarms:
            self._state = replace(self._state, time=now, alarms=alarms)

    def state(self) -> Tracked:
        """What was known at the last look, at most a second of flight ago."""
        return self._state

    def flight(self) -> Flight | None:
        """The flight so far, as far as it is remembered; None before the first command and pose."""
        return self._growing.flight()

    def memory(self) -> dict[str, Any]:
        """What `recall` of another tracker goes on from, as arrays: the flight so far, and its regimes."""
        return {**self._growing.memory(), "following": np.array(json.dumps(self._following.memory()))}

    def recall(self, memory: Mapping[str, Any]) -> None:
        """Goes on from what `memory` gave; before the first sample."""
        self._growing.recall(memory)
        self._following.recall(json.loads(str(memory["following"])))

    def finish(self) -> tuple[Tracked, tuple[Regime, ...]]:
        """What is known at the end, by a last fit, and every regime with its model."""
        if flight := self._growing.flight():
            return self._following.finish(flight, self._growing.now)
        return self._state, ()


class Following:
    """The estimates and regimes of a growing flight.

    Args:
        structure: As `fit` takes it.
        false_alarms_per_hour: Promised.
        earlier: What the vehicle was; None where nothing is known.
    """

    def __init__(
        self,
        structure: str = AVERAGED,
        false_alarms_per_hour: float = FALSE_ALARMS_PER_HOUR,
        earlier: Earlier | None = None,
    ) -> None:
        self._structure, self._earlier = structure, earlier
        self._false_alarms = false_alarms_per_hour * (1.0 - SHARE if earlier else 1.0)
        self._false_comparisons = false_alarms_per_hour * SHARE
        self._compared, self._unlike = 0.0, set[str]()
        self._groups: dict[tuple[str, ...], Group] = {}
        self._since = dict.fromkeys(AXES, 0.0)
        self._changed: dict[str, float] = {}
        self._seen: _Seen | None = None
        self._bounds: list[tuple[float, Alarm | None]] = [(0.0, None)]
        self._model: tuple[tuple[Fit, ...], Model | None] = ((), None)
        self.next_look = LEAST_TIME

    def look(self, flight: Flight, now: float, standing: bool = False) -> Tracked:
        """A look at the flight so far.

        Args:
            flight: Its samples up to now.
            now: [s].
            standing: Whether the vehicle stands, or takes off or lands by itself: no change of it is told then.
        """
        self.next_look += EVERY * max(np.ceil((now - self.next_look) / EVERY + 1e-9), 1.0)
        before = self._as_refitted()
        self._groups = {axes: self._followed(axes, flight, now) for axes in groups_of([flight], flight.axes)}
        if standing:
            self._seen = None
        alarm = None if standing else self._change(now)
        state = self._tracked(flight, now, (alarm,) if alarm else ())
        if self._earlier and state.model is not before and (unlike := self._another_vehicle(state, self._earlier)):
            return replace(state, alarms=(*state.alarms, unlike))
        return state

    def memory(self) -> dict[str, Any]:
        """Regimes and the next look, as plain types; estimates are found anew."""
        bounds = [(since, asdict(alarm) if alarm else None) for since, alarm in self._bounds]
        told = {"compared": self._compared, "unlike": sorted(self._unlike)}
        since = {"since": self._since, "changed": self._changed}
        return {**since, "bounds": bounds, "next_look": float(self.next_look), **told}

    def recall(self, memory: Mapping[str, Any]) -> None:
        """Goes on from what `memory` gave."""
        self._since, self._changed, self.next_look = memory["since"], memory["changed"], memory["next_look"]
        self._bounds = [(since, alarm_from_mapping(alarm) if alarm else None) for since, alarm in memory["bounds"]]
        self._compared, self._unlike = memory.get("compared", 0.0), set(memory.get("unlike", ()))

    def finish(self, flight: Flight, now: float) -> tuple[Tracked, tuple[Regime, ...]]:
        """The last look, each group fitted once more, and the regimes with their models.

        Args:
            flight: All of it.
            now: Its end [s].
        """
        ends = [*(since for since, _ in self._bounds[1:]), now]
        fits = [self._fit(flight, since, end) for (since, _), end in zip(self._bounds, ends, strict=True)]
        regimes = tuple(
            Regime(since, end, found.model if found else None, alarm)
            for (since, alarm), end, found in zip(self._bounds, ends, fits, strict=True)
        )
        for axes, group in self._groups.items():
            part = _part(flight, group.since, now) if group.followed else None
            if fits[-1] and group.since == self._bounds[-1][0]:
                self._groups[axes] = replace(group, followed=followed_of(fits[-1], axes, now))
            elif part:  # what did not change was not begun anew, and is told by more than the last regime
                self._groups[axes] = replace(group, followed=refitted(part, axes, self._structure, now))
        return replace(self._tracked(flight, now, ()), landed=True), regimes

    def _fit(self, flight: Flight, since: float, end: float) -> Fit | None:
        """The fit of a regime; None where it is too short."""
        part = _part(flight, since, end)
        return fit([part], structure=self._structure) if part and part.duration >= LEAST_TIME else None

    def _followed(self, axes: tuple[str, ...], flight: Flight, now: float) -> Group:
        """A group after this look."""
        since = max(self._since[axis] for axis in axes)
        group = self._groups.get(axes, Group(axes, since))
        if group.since != since:
            group = Group(axes, since)
        part = _part(flight, max(since, now - LONGEST), now)
        if part is None or part.duration < LEAST_TIME:
            return group
        before, excited = group.followed, _excited(part, axes, now)
        if before and all(_quiet(flight, axis, now) > QUIET for axis in axes):
            return replace(group, followed=renewed(before, part))  # nothing new is told: the last values hold
        if before is None or excited >= (REFIT if before.estimates else SILENT) * before.seen:
            return replace(group, followed=refitted(part, axes, self._structure, excited))
        return replace(group, followed=stepped(before, part, excited))

    def _change(self, now: float) -> Alarm | None:
        """The alarm of this look, and the regime that begins with it."""
        followed = [group.followed for group in self._groups.values() if group.followed]
        scored = {scores.names: scores for one in followed for scores in _scores(one)}
        looked = {names: looked_for(scores) for names, scores in scored.items()}
        seen, self._seen = self._seen, None
        if seen is None:
            threshold = self._false_alarms * EVERY / 3600.0 / max(sum(looks(scores) for scores in scored.values()), 1)
            found = [(names, one) for names, each in looked.items() for one in each if one.p_value < threshold]
            self._seen = _Seen(*min(found, key=lambda each: each[1].p_value), looked) if found else None
            return None  # a second more tells what it is
        if seen.names not in scored:
            return None
        best, since = since_when(scored[seen.names], seen.contrast)
        if not calm(scored[seen.names], best.since, seen.contrast.p_value):
            return None  # the air, not the vehicle
        others = [
            (scores, there)
            for names, scores in scored.items()
            if names != seen.names
            if (there := at_once(scores, [*seen.looked.get(names, ()), *looked[names]], best.since))
        ]
        named = diagnosis([(scored[seen.names], best), *others])
        p_value = seen.contrast.p_value
        axes = tuple(axis for axis in AXES if axis in named.axes)
        alarm = Alarm(now, axes, named.cause, since, named.change, named.confidence, p_value, named.why)
        for axis in named.axes:
            self._since[axis] = self._changed[axis] = best.since
        self._bounds.append((best.since, alarm))
        self._groups = {
            axes: Group(axes, best.since) if set(axes) & set(named.axes) else group
            for axes, group in self._groups.items()
        }
        return alarm

    def _another_vehicle(self, state: Tracked, earlier: Earlier) -> Alarm | None:
        """The alarm that the vehicle is not that of the earlier model, from a look that has fitted again.

        What is promised is spent with time: a comparison may raise as many as its share of the time since the last.
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

    def _tracked(self, flight: Flight, now: float, alarms: tuple[Alarm, ...]) -> Tracked:
        """The state in words and numbers."""
        known = {axis: group.followed for axes, group in self._groups.items() for axis in axes}
        estimates = {axis: one.estimates[axis] for axis, one in known.items() if one and axis in one.estimates}
        words = {axis: said(one, axis) for axis, one in known.items() if one}
        wide = {axis: wider("damping", one.ci95, one.ci95_flight) for axis, one in words.items()}
        moving, air = motion_now(flight, estimates, wide)
        if any(axis not in words or words[axis].values["damping"] is None for axis in ("x", "y")):
            air = None  # its speed goes by the damping of both
        axes = {
            axis: self._axis(flight, axis, now, known.get(axis), words.get(axis), moving.get(axis))
            for axis in flight.axes
        }
        if self._earlier:
            axes = {axis: self._after(self._earlier, axis, one) for axis, one in axes.items()}
        return Tracked(now, axes, alarms, len(self._bounds) - 1, self._bounds[-1][0], air, self._as_refitted())

    def _after(self, earlier: Earlier, axis: str, out: TrackedAxis) -> TrackedAxis:
        """An axis beside what the earlier model says of it; of one that has changed that says nothing."""
        if axis in self._changed:
            return out
        out = replace(out, against={one.name.partition(".")[2]: one.change for one in compared(out, earlier, axis)})
        return out if axis in self._unlike else until_known(out, earlier, axis)

    def _as_refitted(self) -> Model | None:
        """The model of the last refits; the same one until there is another."""
        parts = [group.followed for group in self._groups.values() if group.followed]
        fits = tuple(part.fit for part in parts)
        if [id(one) for one in fits] != [id(one) for one in self._model[0]]:
            self._model = fits, together(parts)
        return self._model[1]

    def _axis(
        self,
        flight: Flight,
        axis: str,
        now: float,
        followed: Followed | None,
        words: Said | None,
        motion: AxisMotion | None,
    ) -> TrackedAxis:
        """What is known of one axis."""
        knowledge, state = _knowledge(flight, axis, now, followed, words)
        if axis in self._changed:
            state = f"changed at {self._changed[axis]:.1f} s, {state}"
        out = TrackedAxis(knowledge, state)
        if followed and words:
            structure = followed.fit.model.axes[axis].structure
            out = replace(out, values=words.values, ci95=words.ci95, ci95_flight=words.ci95_flight, structure=structure)
        if motion is None or followed is None or words is None or not tells_wind(words.ci95_flight):
            return out
        error = coefficient_error(flight, axis, followed.estimates[axis], words.ci95, words.ci95_flight)
        return replace(
            out,
            wind=motion.wind,
            wind_ci95=_around(motion.wind, float(np.hypot(motion.wind_error, error))),
            gusts=motion.gusts,
            velocity=motion.velocity,
            ahead=motion.ahead,
            ahead_ci95=_around(motion.ahead, motion.ahead_error),
        )


def _knowledge(
    flight: Flight, axis: str, now: float, followed: Followed | None, words: Said | None
) -> tuple[Knowledge, str]:
    """What an axis is, in one word and in words."""
    if not commands_axis(flight, axis):
        return "not_excited", "not excited: no command moves it"
    if followed is None or words is None:
        return "learning", "learning"
    if axis not in followed.estimates:
        silent = followed.fit.model.axes[axis].status["input"] == "not_excited"
        return ("not_excited", "not excited") if silent else ("learning", "learning")
    quiet = _quiet(flight, axis, now)
    if quiet > QUIET:
        return "holding", f"holding (no excitation for {quiet:.0f} s)"
    if all(words.values[name] is not None for name in ("input", "damping", "delay")):
        return "known", "known"
    return "not_identifiable", "not identifiable"


def _around(value: float, error: float) -> Interval:
    return value - NORMAL * error, value + NORMAL * error


def _quiet(flight: Flight, axis: str, now: float) -> float:
    """How long an axis has had the same command [s]."""
    u = flight.command[:, AXES.index(axis)]
    new = np.flatnonzero(np.diff(u))
    return now - float(flight.command_time[new[-1] + 1 if new.size else 0])


def _excited(flight: Flight, axes: Sequence[str], now: float) -> float:
    """Time in which commands of some axes were new, or had not yet had their answer [s]."""
    u = flight.command[:, [AXES.index(axis) for axis in axes]]
    new = flight.command_time[1:][np.any(np.diff(u, axis=0) != 0, axis=1)]
    return float(np.minimum(np.diff(np.append(new, now)), QUIET).sum())


def _part(flight: Flight, since: float, now: float) -> Flight | None:
    """The flight between two times; None where no segment lies there."""
    if since <= flight.segments[0].start and now >= flight.segments[-1].end:
        return flight
    part = between(flight, since, now)
    return part if part.segments and part.pose_time.size > 1 else None


def _scores(followed: Followed) -> list[Scores]:
    """The scores of each likelihood of a group."""
    by_optimum: dict[int, list[tuple[str, Estimate]]] = {}
    for axis, estimate in followed.estimates.items():
        by_optimum.setdefault(id(estimate.optimum), []).append((axis, estimate))
    doubts = {axis: doubt_of(followed.fit.model.axes[axis]) for axis in followed.estimates}
    return [scores_of(each, doubts) for each in by_optimum.values() if each[0][1].records]
