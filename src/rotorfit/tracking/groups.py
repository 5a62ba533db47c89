"""Groups of axes that are fitted together: which part of the flight serves each, and its estimate now."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from rotorfit.core.flight_data import Flight
from rotorfit.core.frames import AXES, Array
from rotorfit.diagnosis.position_loop import restored_axes
from rotorfit.estimation.identifiability import LEAST_TIME
from rotorfit.estimation.likelihood.axis_estimate import Estimate
from rotorfit.estimation.likelihood.optima import between
from rotorfit.estimation.zero_command import commanded_parts
from rotorfit.tracking.excited_time import LONGEST, excited_since, excited_time
from rotorfit.tracking.refits import GroupEstimate, applied, doubt_of
from rotorfit.tracking.scores import Doubts, Estimates, Scores, scores_of, sticks_of

BEGINS = 0.1
"""Step by which the beginning of what a look uses of a long regime moves, as a share of what it uses."""

ENOUGH, FEW = 11.0, 20
"""Time from which on a fit tests whether an axis is only held [s]: `position_loop.LEAST` averages. Before that the test
is made at each look, with this number of averages."""

TESTED = 120.0
"""Length of the part of a long regime that is tested for changes [s]: that of the flights on which the promise was
counted. A change is a matter of the last `scores.WINDOWS`; more of the time before them hardly tells more."""


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
        part = part_between(flight, since, now)
        if part is None or self.answers is None:
            return part
        part = commanded_parts(part, self.axes, self.answers)
        return part if part.segments else None


def held_axes(group: Group, flight: Flight, now: float) -> tuple[str, ...]:
    """The axes of a group whose commands so far are a position controller's, if its last fit was too short to tell."""
    if group.fitted is None or sum(part.duration for part in group.fitted.fit.flights) > ENOUGH:
        return ()
    part = group.part(flight, group.since, now)
    return restored_axes([part], group.axes, FEW) if part else ()


def recent_groups(groups: Mapping[tuple[str, ...], Group], flight: Flight, now: float) -> list[GroupEstimate]:
    """The estimates of groups, unmoved, applied to what is tested of the flight so far."""
    out = []
    for group in groups.values():
        if group.fitted is None:
            continue
        part = group.part(flight, _last(TESTED, group.since, now), now)
        if part and part.duration >= LEAST_TIME:
            out.append(applied(group.fitted, part))
    return out


def looks_back(flight: Flight, axes: Sequence[str], since: float, now: float) -> float:
    """Time from which the estimates of a look use the flight [s]: at least `LONGEST` of excited time back.

    It is the regime's start where that is no longer ago, or nothing before is remembered. A hover, in which nothing is
    learnt, makes nothing forgotten.

    Args:
        flight: The flight, as far as it is remembered.
        axes: Those whose excited time counts.
        since: Start of the regime [s].
        now: Time of the look [s].
    """
    begin = excited_since(flight.command_time, _commands(flight, axes), since, now)
    return since if begin <= since else _in_steps(LONGEST, since, begin)


def _last(longest: float, since: float, now: float) -> float:
    """The time [s] that lies at least `longest` back, in a regime so long; else the regime's start."""
    return _in_steps(longest, since, now - longest)


def _in_steps(longest: float, since: float, begin: float) -> float:
    """The beginning of what is used, moved in steps: what was learnt of the velocity there holds until the next."""
    step = BEGINS * longest
    return max(since, step * float(np.floor(begin / step)))


def quiet_for(flight: Flight, axis: str, now: float) -> float:
    """How long the command of an axis has not changed [s]."""
    u = flight.command[:, AXES.index(axis)]
    new = np.flatnonzero(np.diff(u))
    return now - float(flight.command_time[new[-1] + 1 if new.size else 0])


def new_excited_time(group: Group, flight: Flight, now: float) -> float:
    """Excited time of a group since it was counted last [s]."""
    commands = _commands(flight, group.axes)
    return excited_time(flight.command_time, commands, max(group.looked, group.since), now)


def _commands(flight: Flight, axes: Sequence[str]) -> Array:
    return flight.command[:, [AXES.index(axis) for axis in axes]]


def part_between(flight: Flight, since: float, now: float) -> Flight | None:
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
    parts = [part for one in fitted for part in _likelihoods(one)]
    return scores_of(parts, sticks_of(flight, parts), gusts)


def _likelihoods(fitted: GroupEstimate) -> list[tuple[Estimates, Doubts]]:
    """The likelihoods of a group, each with the doubts about its laws."""
    by_optimum: dict[int, list[tuple[str, Estimate]]] = {}
    for axis, estimate in fitted.estimates.items():
        by_optimum.setdefault(id(estimate.optimum), []).append((axis, estimate))
    doubts = {axis: doubt_of(fitted.fit.model.axes[axis]) for axis in fitted.estimates}
    return [(each, doubts) for each in by_optimum.values() if each[0][1].records]
