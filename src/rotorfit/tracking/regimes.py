"""The regimes of a flight: the time between two changes, and the model that it tells.

A change of some axes ends nothing for the others. Between the two ends of the interval of its instant nobody knows
which vehicle flew: the regime before it is fitted up to the one, the regime after it from the other.
"""

from collections.abc import Collection, Mapping, Sequence

from rotorfit.core.flight_data import Flight
from rotorfit.core.frames import AXES
from rotorfit.core.results import Fit
from rotorfit.core.tracked import Alarm, Regime
from rotorfit.estimation.fitting import fit
from rotorfit.estimation.identifiability import LEAST_TIME
from rotorfit.tracking.groups import part_between
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
    flight: Flight, bounds: Bounds, groups: Sequence[tuple[str, ...]], structure: str, now: float
) -> tuple[tuple[Regime, ...], Mapping[tuple[str, ...], GroupEstimate]]:
    """The regimes with their models, and the estimate of each group in the last one, where it is long enough.

    Each group is fitted to all of the flight around a regime in which it did not change. So the models of two regimes
    are equal in the axes that did not change between them.

    Args:
        flight: The whole flight.
        bounds: Its regimes.
        groups: The axes that are fitted together.
        structure: Model structure, as `fit` takes it.
        now: End of the flight [s].
    """
    ends = [*(begin for begin, _ in bounds[1:]), now]
    spans = [(begin, end) for (begin, _), end in zip(bounds, ends, strict=True)]
    unchanged = [{axes: _unchanged(bounds, axes, span, now) for axes in groups} for span in spans]
    fitted: dict[Span, set[str]] = {}
    for each in unchanged:
        for axes, span in each.items():
            fitted[span] = fitted.get(span, set()) | set(axes)
    fits = {span: _fit(flight, span, AXES if len(fitted) == 1 else axes, structure) for span, axes in fitted.items()}
    parts = [
        {axes: group_estimate(found, axes, now) for axes, span in each.items() if (found := fits[span])}
        for each in unchanged
    ]
    regimes = tuple(
        Regime(*span, together(list(each.values())), alarm)
        for span, each, (_, alarm) in zip(spans, parts, bounds, strict=True)
    )
    return regimes, parts[-1]


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
