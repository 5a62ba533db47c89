"""Tests a growing flight for changes of the vehicle: raises alarms, and revises them.

An alarm is raised by the test that finds a change, with the cause that is probable by then. It begins a new regime. A
second later the cause is named again, from the estimates before the change and more data, and the alarm is revised: its
regime is then as if it had been raised like that. Only then it says by how much: in a fraction of a second the size of
a change and its time explain each other, and no interval of either alone holds.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from rotorfit.core.flight_data import Flight
from rotorfit.core.tracked import Alarm
from rotorfit.estimation.identifiability import LEAST_TIME
from rotorfit.estimation.zero_command import late_by
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
from rotorfit.tracking.groups import Group, looks_back, recent_groups, scores_of_groups
from rotorfit.tracking.instant import changed_when
from rotorfit.tracking.learnt import Learnt, after_change
from rotorfit.tracking.refits import believed_laws, refitted
from rotorfit.tracking.scores import CHUNK, WINDOWS
from rotorfit.tracking.watched_time import WatchedTime

GLANCE = 0.25
"""Time between tests [s]."""

REVISED = 1.0
"""Time from an alarm to its revision [s]."""

SAGS = 10.0
"""Time for which a revision waits while the vehicle may have touched down [s]."""

JOINS, JOINING = 1e-5, 20.0
"""p-value below which another axis changed with those of an alarm, and for how long after it that is asked [s]. Its
instant is known, so that no window is chosen; that an alarm is true has been shown before."""

RESTLESS = 0.97
"""Commanded share of a regime above which the vehicle's behaviour at rest cannot explain a change."""

STRONG = 3.0
"""Log-odds that count as strong evidence (R. E. Kass, A. E. Raftery, J. Amer. Statist. Assoc. 90 (1995), pp. 773-795,
section 3.2)."""


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
    before: Learnt


@dataclass(frozen=True)
class _Suspicion:
    """A change that a test has found and that something else may explain.

    Attributes:
        names: Names of the scores of the likelihood that shows it.
        before: When it began at the earliest [s].
        threshold: p-value below which a contrast shows a change.
    """

    names: tuple[str, ...]
    before: float
    threshold: float


class ChangeWatch:
    """The tests of a growing flight.

    Args:
        structure: Model structure, as `fit` takes it.
        false_alarms_per_hour: Promised bound on their expected number [1/h].

    Attributes:
        watched: Since when each axis is tested, and how much of its time.
    """

    def __init__(self, structure: str, false_alarms_per_hour: float) -> None:
        self.watched = WatchedTime()
        self._structure, self._false_alarms = structure, false_alarms_per_hour
        self._raised: _Raised | None = None
        self._told: _Raised | None = None  # the alarm that was revised last
        self._suspected: float | None = None
        self._sinking: _BeforeSinking | None = None

    def suspects(self, now: float) -> bool:
        """Whether a change may have come that only the air speaks against: what is learnt of it would hide it."""
        return self._suspected is not None and now < self._suspected + NEW

    def begin_anew(self) -> None:
        """Lets the alarms so far stand as they are: a revision would go back to before what has happened since."""
        self._raised = self._told = self._sinking = None

    def test(
        self, learnt: Learnt, flight: Flight, now: float, standing: bool, lengths: Sequence[float] = WINDOWS
    ) -> tuple[Alarm | None, Learnt]:
        """The alarm that is raised or revised now, if there is one, and what is known after the test.

        Args:
            learnt: What is known before.
            flight: The flight so far.
            now: Time of the test [s].
            standing: Whether the vehicle stands, may touch down, or takes off or lands by itself: then nothing is
                tested.
            lengths: Lengths of the windows that are tested [s].
        """
        raised, self._raised = self._raised, None
        suspected, self._suspected = self._suspected, None
        if standing:  # a vehicle that sags under a payload is flown on, one that lands may be another one afterwards
            self._raised = raised if raised and now < raised.found + SAGS else None
            self._sinking = (
                replace(self._sinking, until=now) if self._sinking else _BeforeSinking(now, now, learnt.groups)
            )
            return None, learnt
        if self._sinking and now > self._sinking.until + NEW:
            self._sinking = None
        if raised and now < raised.found + REVISED - 1e-6:
            self._raised = raised
            return None, learnt
        if raised:
            return self._revision(learnt, flight, now, raised)
        return self._search(learnt, flight, now, lengths, suspected)

    def _search(
        self, learnt: Learnt, flight: Flight, now: float, lengths: Sequence[float], suspected: float | None
    ) -> tuple[Alarm | None, Learnt]:
        """What `test` returns where nothing was found before; `suspected` is since when a change may have come [s]."""
        before = replace(learnt, groups=self._sinking.groups) if self._sinking else learnt
        back = NEW + (min(now - self._sinking.since, SAGS) if self._sinking else 0.0)
        if all(now - group.since < (LEAST_CHUNKS - 1) * CHUNK for group in before.groups.values()):
            return None, learnt  # no window has a rest that is long enough
        known = recent_groups(before.groups, flight, now)
        scored = {scores.names: scores for scores in scores_of_groups(known, flight)}
        looked, count = looked_together(list(scored.values()), lengths, back)
        threshold = self._false_alarms * GLANCE / 3600.0 / max(count, 1)
        self.watched.note(scored, lengths, now, learnt.alarms)
        found = rarest(known, flight, looked, lengths, back, threshold)
        if not found:
            self._raised = self._joined(flight, now) if lengths == WINDOWS else None
            return None, learnt
        names, first, p_value = found
        best = likeliest(scored[names], first, looked[names])
        when, since = changed_when(scored[names], earliest(scored[names], first))
        earlier = min(since[0], best.since)
        if not calm(scored[names], earlier, best.since, p_value):
            self._suspected = suspected or now
            return None, learnt  # the air, not the vehicle
        seen = _Suspicion(names, earlier, threshold)
        other = None if seen_in_z_or_yaw(looked, first) else self._at_rest(before.groups, flight, now, seen)
        other = other or _under_another_law(before.groups, flight, now, seen)
        if other:
            self._suspected = suspected or now  # a change that is barely seen may show in the answers a moment later
            return None, self._holding(learnt, other)  # not another vehicle: it obeys another law than was held so far
        if self._told and is_same(self._told.alarm, since, now):
            self._raised = replace(self._told, found=now, names=names, contrast=first, p_value=p_value, looked=looked)
            return None, learnt  # nothing new, but more of it
        odds = odds_of_pushes(scored, since) if best.jolt else np.inf
        named = diagnosed(scored, names, [best], looked, {}, odds)
        alarm = alarm_of(flight, now, named, since, p_value)
        self._raised, self._sinking = _Raised(alarm, now, names, first, p_value, looked, before), None
        return alarm, after_change(learnt, before, alarm, when)

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

    def _revision(self, learnt: Learnt, flight: Flight, now: float, raised: _Raised) -> tuple[Alarm | None, Learnt]:
        """The alarm in place of one that was raised, from the estimates before it and the data until `REVISED` after.

        It begins the regime anew.
        """
        groups = recent_groups(raised.before.groups, flight, min(now, raised.found + REVISED))
        scores = scores_of_groups(groups, flight)
        scored = {one.names: one for one in scores}
        if raised.names not in scored:
            return None, learnt
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
        self._told, self._sinking = replace(raised, alarm=alarm), None
        return alarm, after_change(learnt, raised.before, alarm, when)

    def _holding(self, learnt: Learnt, group: Group) -> Learnt:
        """Another estimate of a group from now on, and in place of that from before the vehicle sank."""
        if self._sinking:
            self._sinking = replace(self._sinking, groups={**self._sinking.groups, group.axes: group})
        return learnt.holding(group)

    def _at_rest(
        self, groups: Mapping[tuple[str, ...], Group], flight: Flight, now: float, seen: _Suspicion
    ) -> Group | None:
        """The group of x and y by its answers to commands, where these show no change: many vehicles brake at rest.

        So the change was only found because they obey another law at rest. The answers are fitted alone, up to the time
        before the change if that is long enough; from then on they are.
        """
        for axes, group in groups.items():
            if group.fitted is None or group.answers is not None or set(axes) & {"z", "yaw"}:
                continue
            if not _concerns(seen, axes):
                continue
            late = [late_by(one) for one in group.fitted.estimates.values()]
            apart = replace(group, answers=min(late))
            begin = looks_back(flight, axes, group.since, now)
            whole, answers = (one.part(flight, begin, now) for one in (group, apart))
            if not (whole and answers and LEAST_TIME <= answers.duration <= RESTLESS * whole.duration):
                continue
            first = apart.part(flight, begin, seen.before)
            part = first if first and first.duration >= LEAST_TIME else answers
            apart = replace(apart, fitted=refitted(part, axes, self._structure, group.fitted.seen))
            if _shows_nothing({axes: apart}, flight, now, seen.threshold):
                return apart
        return None


def _under_another_law(
    groups: Mapping[tuple[str, ...], Group], flight: Flight, now: float, seen: _Suspicion
) -> Group | None:
    """A group under a law that shows no change, where the flight before could not tell which of several holds.

    A lag that turns with the vehicle and one that keeps its direction are the same until it turns. So a change must be
    one under each believed law, fitted up to the time before the change. From then on the law is held that shows none,
    until the next look weighs all of them anew.
    """
    for axes, group in groups.items():
        if group.fitted is None or not _concerns(seen, axes):
            continue
        part = group.part(flight, looks_back(flight, axes, group.since, now), seen.before)
        if part is None or part.duration < LEAST_TIME:
            continue
        for law in believed_laws(group.fitted):
            fitted = refitted(part, axes, law, seen=0.0)
            other = replace(group, fitted=fitted)
            if fitted.estimates and _shows_nothing({**groups, axes: other}, flight, now, seen.threshold):
                return other
    return None


def _concerns(seen: _Suspicion, axes: Sequence[str]) -> bool:
    """Whether a suspicion rests on one of some axes."""
    return any(name.partition(".")[0] in axes for name in seen.names)


def _shows_nothing(groups: Mapping[tuple[str, ...], Group], flight: Flight, now: float, threshold: float) -> bool:
    """Whether a look at groups finds no contrast with a p-value below a threshold, and at least tests for one."""
    looked, _ = looked_together(scores_of_groups(recent_groups(groups, flight, now), flight))
    return bool(looked) and not any(one.p_value < threshold for each in looked.values() for one in each)
