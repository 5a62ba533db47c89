"""Alarms: the rarest contrast of a look, its probable cause, and by how much something changed."""

from collections.abc import Collection, Mapping, Sequence
from dataclasses import replace

from scipy.special import expit

from rotorfit.core.flight_data import Flight
from rotorfit.core.frames import AXES
from rotorfit.core.tracked import Alarm
from rotorfit.tracking.causes import Diagnosis, diagnosis, natural
from rotorfit.tracking.changes import UNLIKELY, Contrast, at_once, in_any_air, pushes
from rotorfit.tracking.drag import is_drag
from rotorfit.tracking.groups import scores_of_groups
from rotorfit.tracking.push import odds_of_a_push, push_interval
from rotorfit.tracking.refits import GroupEstimate
from rotorfit.tracking.scores import GUST_POWERS, Scores
from rotorfit.tracking.shift import shift_interval

SAME = 5.0
"""Time after an alarm was raised in which other axes that may have changed at its instant are part of its change [s].
"""

PUSHES = ("payload", "thrust")
"""Causes that push by themselves."""

SHARED_SHIFTS = ("delay", "limits")
"""Causes that shift the coefficients that they change by the same amount."""

WORTH_SAYING = 0.01
"""Least share of the evidence that is told."""

HEAVIER = "x and y are learnt anew, as their damping is drag over mass"


def rarest(
    known: Sequence[GroupEstimate],
    flight: Flight,
    looked: Mapping[tuple[str, ...], Sequence[Contrast]],
    lengths: Sequence[float],
    back: float,
    threshold: float,
) -> tuple[tuple[str, ...], Contrast, float] | None:
    """The contrast with the smallest p-value below a threshold: names of its scores, and its p-value in any air."""
    found = [(names, one) for names, each in looked.items() for one in each if one.p_value < threshold]
    if not found:
        return None
    names, first = min(found, key=lambda each: each[1].p_value)
    p_value = first.p_value
    if pushes(names, first):
        under = [scores_of_groups(known, flight, gusts) for gusts in range(1 + len(GUST_POWERS))]
        p_value = max(p_value, in_any_air(names, under, lengths, back))
    return (names, first, p_value) if p_value <= threshold else None


def seen_in_z_or_yaw(looked: Mapping[tuple[str, ...], Sequence[Contrast]], first: Contrast) -> bool:
    """Whether z or yaw, which do not brake, answer otherwise since the same instant."""
    return any(
        one.since == first.since and one.p_value < UNLIKELY
        for names, each in looked.items()
        if not {name.partition(".")[0] for name in names} & {"x", "y"}
        for one in each
    )


def diagnosed(
    scored: Mapping[tuple[str, ...], Scores],
    names: tuple[str, ...],
    shown: Sequence[Contrast],
    looked: Mapping[tuple[str, ...], Sequence[Contrast]],
    earlier: Mapping[tuple[str, ...], Sequence[Contrast]],
    odds: float,
) -> Diagnosis:
    """Names a change by a contrast that shows it, at each instant when it may have come, and what the others show then.

    Args:
        scored: Scores of each likelihood, by their names.
        names: Those of the likelihood that shows it.
        shown: Its contrast, or that of each instant.
        looked: All contrasts of this look, likewise.
        earlier: Those of the look that raised the alarm.
        odds: Logarithm of the odds of a push, from which follows the share of the evidence for other coefficients.
    """
    instants = [
        [
            (scored[names], one),
            *(
                (scores, there)
                for other, scores in scored.items()
                if other != names and (there := at_once(scores, [*earlier.get(other, ()), *looked[other]], one))
            ),
        ]
        for one in shown
    ]
    named = diagnosis(*instants)
    share = float(expit(-odds))
    if not shown[0].jolt or named.cause not in PUSHES or share < WORTH_SAYING:
        return named
    doubt = f"or it was no push but another delay, gain or damping, with {100 * share:.0f} % of the evidence"
    return replace(named, confidence=(1 - share) * named.confidence, why=f"{named.why}; {doubt}")


def odds_of_pushes(scored: Mapping[tuple[str, ...], Scores], since: tuple[float, float]) -> float:
    """Logarithm of the odds that z and yaw were pushed, against other coefficients of theirs since then."""
    return sum(odds_of_a_push(scores, since) for scores in scored.values() if scores.jolts.size)


def sizes(
    named: Diagnosis, scored: Mapping[tuple[str, ...], Scores], since: tuple[float, float], window: float
) -> Mapping[str, tuple[float, float]]:
    """The intervals of a change for any instant of `since`; a push has that of its first acceleration.

    A ratio of gains whose interval reaches across zero is left out: it tells no size.
    """
    axes = {name: next(scores for names, scores in scored.items() if name in names) for name in named.shifted}
    if named.cause in PUSHES:
        return {name: push_interval(scores, since) for name, scores in axes.items()}
    change, shift = named.change, None
    if named.cause in SHARED_SHIFTS:
        shift = shift_interval(scored.values(), named.shifted, since, window)
    if shift:
        size = {name: float(scores.scale[scores.names.index(name)]) for name, scores in axes.items()}
        change = {name: natural(name, (shift[0] * size[name], shift[1] * size[name])) for name in axes}
    return {name: (low, high) for name, (low, high) in change.items() if not (_is_gain(name) and low <= 0.0 <= high)}


def _is_gain(name: str) -> bool:
    return name.endswith(".input")


def with_sizes(alarm: Alarm, named: Diagnosis, change: Mapping[str, tuple[float, float]], revises: float) -> Alarm:
    """An alarm that takes the place of one raised at `revises` [s]: it says by how much, and where it cannot."""
    untold = [name for name in named.shifted if name not in change]
    why = f"{alarm.why}; by how much {' and '.join(untold)} changed, the flight does not tell" if untold else alarm.why
    return replace(alarm, change=change, revises=revises, why=why)


def alarm_of(flight: Flight, now: float, named: Diagnosis, since: tuple[float, float], p_value: float) -> Alarm:
    """A new alarm, of a change that came within an interval [s]."""
    heavier = [axis for axis in flight.axes if named.cause == "payload" and is_drag(flight.card, axis)]
    return Alarm(
        time=now,
        axes=tuple(axis for axis in AXES if axis in named.axes or axis in heavier),
        cause=named.cause,
        since=since,
        change={},
        confidence=named.confidence,
        p_value=p_value,
        why=f"{named.why}; {HEAVIER}" if heavier else named.why,
    )


def joined_alarm(told: Alarm, more: Alarm, joined: Collection[str]) -> Alarm:
    """An alarm and what was found of it later, on the axes `joined`: none that was told of is as it was before.

    Where the later one does not explain all axes, the cause is that of the surer one and the instant that of the first.
    """
    every = {*told.axes, *more.axes, *joined}
    if every <= set(more.axes):
        return more
    surer = max(more, told, key=lambda one: one.confidence)
    whole = replace(more, axes=tuple(axis for axis in AXES if axis in every), since=told.since)
    change = {**more.change, **told.change}
    return replace(whole, change=change, cause=surer.cause, confidence=surer.confidence, why=surer.why)


def is_same(told: Alarm, since: tuple[float, float], now: float) -> bool:
    """Whether a change that came at an instant within an interval [s] may be the one that was told of a moment ago."""
    return now < told.raised + SAME and since[0] <= told.since[1] and told.since[0] <= since[1]
