"""The regimes of a flight: the time between two changes, and the model that it tells.

A change of some axes ends nothing for the others. Between the two ends of the interval of its instant nobody knows
which vehicle flew: the regime before it is fitted up to the one, the regime after it from the other.

A live flight remembers its last seconds only. A regime is fitted for good when its own begin to be forgotten, and to
these alone: seconds after it do not stand in for them, as a vehicle may drift without an alarm.
"""

from collections.abc import Collection, Mapping, Sequence
from itertools import pairwise
from types import MappingProxyType

import numpy as np

from rotorfit.core.flight_data import Flight
from rotorfit.core.frames import AXES
from rotorfit.core.model import Model
from rotorfit.core.results import Fit
from rotorfit.core.tracked import Alarm, Regime
from rotorfit.estimation.fitting import fit
from rotorfit.estimation.identifiability import LEAST_TIME
from rotorfit.tracking.groups import looks_back, part_between
from rotorfit.tracking.refits import GroupEstimate, group_estimate, together
from rotorfit.tracking.scores import FADES, TRIMMED

SETTLES = 3 * FADES
"""Time in which an autopilot learns a new weight or torque [s]: until then the vehicle obeys no law of ours."""

Span = tuple[float, float]
"""Start and end [s]."""

Bounds = Sequence[tuple[float, Alarm | None]]
"""Start of each regime [s] and the alarm that began it."""


def learnt_from(alarm: Alarm, axes: Collection[str]) -> float:
    """Time from which a flight tells of axes that changed [s]: a new weight or torque has been learnt by then."""
    pushed = set(axes) & set(TRIMMED) and alarm.cause in ("payload", "thrust")
    return alarm.since[1] + (SETTLES if pushed else 0.0)


def regimes_of(
    flight: Flight,
    bounds: Bounds,
    groups: Sequence[tuple[str, ...]],
    structure: str,
    now: float,
    begin: float = 0.0,
    kept: Mapping[float, Model | None] = MappingProxyType({}),
) -> tuple[tuple[Regime, ...], Mapping[tuple[str, ...], GroupEstimate]]:
    """The regimes with their models, and the estimate of each group in the last one, where it is long enough.

    Each group is fitted to all of the flight around a regime in which it did not change. So the models of two regimes
    are equal in the axes that did not change between them, but for those that were fitted for good before.

    Args:
        flight: The flight, as far as it is remembered.
        bounds: Its regimes.
        groups: The axes that are fitted together.
        structure: Model structure, as `fit` takes it.
        now: End of the flight [s].
        begin: Start of the flight, or of the part of it that is tracked [s].
        kept: Start of a regime that `fading` names to the model that it had then.
    """
    spans, first = _spans(bounds, now), max(begin, flight.span[0])
    gone = fading(flight, bounds, begin, groups)
    unchanged = [
        {} if span[0] in gone else {axes: _unchanged(bounds, axes, span, now) for axes in groups} for span in spans
    ]
    parts = _parts(flight, unchanged, structure, now)
    models = [
        kept.get(span[0]) if span[0] in gone else together(list(each.values()))
        for span, each in zip(spans, parts, strict=True)
    ]
    regimes = tuple(
        Regime(*span, model, alarm, _data(model), first if first > max(span[0], begin) else None)
        for span, model, (_, alarm) in zip(spans, models, bounds, strict=True)
    )
    return regimes, parts[-1]


def fading(flight: Flight, bounds: Bounds, begin: float, groups: Sequence[tuple[str, ...]]) -> list[float]:
    """Starts of the regimes that have ended and of which seconds are forgotten that an estimate looks back over [s].

    Args:
        flight: The flight, as far as it is remembered.
        bounds: Its regimes.
        begin: Start of the flight, or of the part of it that is tracked [s].
        groups: The axes that are fitted together: one that is rarely commanded looks back further.
    """
    return [
        start
        for start, end in _spans(bounds, np.inf)[:-1]
        if any(flight.span[0] > max(begin, looks_back(flight, axes, start, end)) for axes in groups)
    ]


def model_of_own(
    flight: Flight, bounds: Bounds, groups: Sequence[tuple[str, ...]], structure: str, start: float
) -> Model | None:
    """The model of a regime that has ended, fitted to what is remembered of it; None if that is too short.

    Args:
        flight: The flight, as far as it is remembered.
        bounds: Its regimes.
        groups: The axes that are fitted together.
        structure: Model structure, as `fit` takes it.
        start: Start of the regime [s].
    """
    end = next(end for begin, end in _spans(bounds, np.inf) if begin == start)
    around = {axes: _unchanged(bounds, axes, (start, end), end) for axes in groups}
    own = {
        axes: (max(low, looks_back(flight, axes, start, end)), min(high, end)) for axes, (low, high) in around.items()
    }
    return together(list(_parts(flight, [own], structure, end)[0].values()))


def _spans(bounds: Bounds, now: float) -> list[Span]:
    """Start and end of each regime [s]."""
    return list(pairwise([*(begin for begin, _ in bounds), now]))


def _parts(
    flight: Flight, unchanged: Sequence[Mapping[tuple[str, ...], Span]], structure: str, now: float
) -> list[Mapping[tuple[str, ...], GroupEstimate]]:
    """For each regime the estimates of the groups that are given a long enough stretch of flight [s]."""
    fitted: dict[Span, set[str]] = {}
    for each in unchanged:
        for axes, span in each.items():
            fitted[span] = fitted.get(span, set()) | set(axes)
    fits = {span: _fit(flight, span, AXES if len(fitted) == 1 else axes, structure) for span, axes in fitted.items()}
    return [
        {axes: group_estimate(found, axes, now) for axes, span in each.items() if (found := fits[span])}
        for each in unchanged
    ]


def _data(model: Model | None) -> Span | None:
    """From which to which second a model of one flight was fitted [s]."""
    return (min(s.span[0] for s in model.flights), max(s.span[1] for s in model.flights)) if model else None


def _unchanged(bounds: Bounds, axes: Collection[str], regime: Span, now: float) -> Span:
    """The time around a regime in which none of some axes changed [s]."""
    start, end = regime
    changes = [(when, alarm) for when, alarm in bounds if alarm and set(alarm.axes) & set(axes)]
    begins = [learnt_from(alarm, axes) for when, alarm in changes if when <= start]
    return max(begins, default=0.0), min((alarm.since[0] for when, alarm in changes if when >= end), default=now)


def _fit(flight: Flight, span: Span, axes: Collection[str], structure: str) -> Fit | None:
    """The fit of some axes to a stretch of the flight [s]; None if it is too short."""
    part = part_between(flight, *span) if span[1] - span[0] >= LEAST_TIME else None
    wanted = [axis for axis in AXES if axis in axes]
    return fit([part], axes=wanted, structure=structure) if part and part.duration >= LEAST_TIME else None
