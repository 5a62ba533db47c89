"""Model -> Model: the uncertainty of clocks, rows and velocity latencies is added to the interval of the delay."""

from collections.abc import Mapping, Sequence
from dataclasses import replace
from types import MappingProxyType

import numpy as np

from rotorfit.core.errors import FlightError
from rotorfit.core.flight_data import Flight
from rotorfit.core.frames import AXES
from rotorfit.core.model import NORMAL, Axis, Combination, Interval, Model, Weighed, weighed
from rotorfit.estimation.identifiability import WIDEST_DELAY

_WITH_DELAY = ("total_lag", "delay_plus_lag")

DELAYS = ("delay", *_WITH_DELAY)
"""Names of what errors of the stamps are in."""

Ends = tuple[float, float]
"""By how much a delay may be shorter, and longer [s]."""

NOTHING: Mapping[str, Ends] = MappingProxyType({})
"""No error of any axis."""

_NEITHER = (0.0, 0.0)


def check_clocks(flights: Sequence[Flight]) -> None:
    """Refuses flights if the clock offsets of some include the delay and those of others do not.

    A fit has one delay per axis.

    Raises:
        FlightError: The flights are mixed.
    """
    without = [flight.path for flight in flights if flight.clocks and flight.clocks.includes_delay]
    if without and len(without) < len(flights):
        raise FlightError(
            f"{without[0]}: its clock offset is known only from the response to the commands and includes the "
            "delay: fit this flight separately, or name the vehicle's own velocity in the card"
        )


def clock_half_width(flights: Sequence[Flight], axis: str) -> float:
    """Half the 95 % interval of the delay of an axis that is due to the clocks alone [s].

    The delay of a fit is taken as the mean over its flights, weighted by their length; the errors of their clocks are
    independent, but for what card or link state of all stamps.
    """
    k = AXES.index(axis)
    moving = [f for f in flights if axis in f.axes and np.any(f.command[:, k])]
    if not moving:
        return 0.0
    length = sum(f.duration for f in moving)
    alike = max(f.shared_error for f in moving)
    own = [np.hypot(f.stamp_error, f.clocks.half_width if f.clocks else 0.0) for f in moving]
    return float(np.hypot(alike, np.linalg.norm([f.duration / length * h for f, h in zip(moving, own, strict=True)])))


def lateness(flights: Sequence[Flight], axis: str) -> Ends:
    """By how much the delay of an axis may be shorter, and longer [s].

    Shorter as poses were measured before their stamps, or commands were held until lines led to the next; longer as
    commands were sent before their stamps; either by the step of a coarse clock. The means over the flights, weighted
    by their length; a logger is as late on one flight as on the next.
    """
    k = AXES.index(axis)
    moving = [f for f in flights if axis in f.axes and np.any(f.command[:, k])]
    length = sum(f.duration for f in moving)
    return (
        sum(f.duration / length * (max(f.pose_lateness, f.stamp_step) + f.command_lead) for f in moving),
        sum(f.duration / length * max(f.command_lateness, f.stamp_step) for f in moving),
    )


def with_clock_error(model: Model, flights: Sequence[Flight]) -> Model:
    """The model with the uncertainty of its flights' clocks in the delays.

    Where an offset between two clocks was measured, or stamps were corrected by their arrival times, that error is
    added in quadrature to the errors of the delay, of delay plus lag and of the total lag. Where commands bear the
    stamps of rows of poses, upper ends are raised by the period of the rows; where poses bear those of later rows,
    lower ends are lowered by it, and where lines were drawn between commands, by half their period; where a clock is
    coarse, both are moved by its step. Where only the response to the commands revealed the offset, no delay is
    published, and its rows leave the covariance.

    Args:
        model: As fitted to the stamps on one clock.
        flights: The flights that it was fitted to.
    """
    half = {axis: clock_half_width(flights, axis) for axis in AXES}
    wider = with_delay_error(model, half, (AXES,), {axis: lateness(flights, axis) for axis in AXES})
    held = [flight.clocks for flight in flights if flight.clocks and flight.clocks.includes_delay]
    if not held:
        return wider
    offset = held[0].offset if len(flights) == 1 else None
    kept = [i for i, name in enumerate(wider.covariance_names) if not name.endswith(".delay")]
    return replace(
        wider,
        axes={name: _without_delay(axis, offset) for name, axis in wider.axes.items()},
        covariance_names=tuple(wider.covariance_names[i] for i in kept),
        covariance=wider.covariance[np.ix_(kept, kept)],
    )


def with_delay_error(
    model: Model, half: Mapping[str, float], shared: Sequence[Sequence[str]], beyond: Mapping[str, Ends] = NOTHING
) -> Model:
    """The model with further, independent errors of its delays.

    Args:
        model: As fitted.
        half: Axis to half the 95 % interval of an error [s], added in quadrature.
        shared: Groups of axes whose delays share the errors.
        beyond: Axis to the times by which the delay may be shorter, and longer [s], by which the ends are moved; any
            share of each is equally likely.
    """
    if not any(half.values()) and not any(map(any, beyond.values())):
        return model
    axes = {name: _widened(axis, half.get(name, 0.0), beyond.get(name, _NEITHER)) for name, axis in model.axes.items()}
    covariance = model.covariance.copy()
    delays = [(i, name.split(".")[0]) for i, name in enumerate(model.covariance_names) if name.endswith(".delay")]
    for i, one in delays:
        for j, other in delays:
            if any(one in group and other in group for group in shared):
                covariance[i, j] += half.get(one, 0.0) * half.get(other, 0.0) / NORMAL**2
                for these, those in zip(beyond.get(one, _NEITHER), beyond.get(other, _NEITHER), strict=True):
                    covariance[i, j] += these * those / 12
    return replace(model, axes=axes, covariance=covariance)


def _without_delay(axis: Axis, offset: float | None) -> Axis:
    """The axis without a delay; with the sum of offset and delay, which was measured, where an offset [s] is given."""
    if axis.predictor is None:
        return axis
    kept = {name: one for name, one in axis.combinations.items() if name not in _WITH_DELAY}
    if offset is not None:
        low, high = (None if end is None else offset + end for end in axis.ci95["delay"])
        kept["offset_plus_delay"] = Combination(offset + axis.predictor.delay, (low, high))
    return replace(
        axis,
        delay=None,
        stderr={**axis.stderr, "delay": None},
        ci95={**axis.ci95, "delay": (None, None)},
        ci95_flight={**axis.ci95_flight, "delay": (None, None)} if axis.ci95_flight else {},
        status={**axis.status, "delay": "not_identifiable"},
        combinations=kept,
        spread={name: one for name, one in axis.spread.items() if name not in DELAYS},
        laws=tuple(_law_without_delay(law) for law in axis.laws),
    )


def _law_without_delay(law: Weighed) -> Weighed:
    """The law with the uncertainty of its other parameters alone."""
    names = [name for name in law.stderr if name != "delay"]
    at = [list(law.stderr).index(name) for name in names]
    covariance = law.covariance[np.ix_(at, at)]
    return weighed(law.structure, law.predictor, names, covariance, law.weight, law.log_likelihood)


def _widened(axis: Axis, half: float, beyond: Ends) -> Axis:
    """The axis with independent errors of its delay added, see `with_delay_error` [s]."""
    center = axis.predictor.delay if axis.predictor else None
    if center is None or not (half or any(beyond)) or axis.ci95["delay"] == (None, None):
        return axis
    low, high = ends = wider(axis.ci95["delay"], _middle(axis.ci95["delay"], axis.delay, center), half, beyond)
    own = dict(axis.ci95_flight)
    if own:
        own["delay"] = wider(own["delay"], _middle(own["delay"], None, center), half, beyond)
    error = axis.stderr["delay"]
    wide = low is None or high is None or high - low >= WIDEST_DELAY
    lost = wide or axis.status["delay"] != "ok"
    return replace(
        axis,
        delay=None if lost else axis.delay,
        stderr={**axis.stderr, "delay": None if lost or error is None else _summed(error, half, beyond)},
        ci95={**axis.ci95, "delay": ends},
        ci95_flight=own,
        status={**axis.status, "delay": "not_identifiable"} if wide else axis.status,
        combinations={
            name: _combination(one, half, beyond) if name in _WITH_DELAY else one
            for name, one in axis.combinations.items()
        },
        spread={
            name: replace(one, next_flight=wider(one.next_flight, _middle(one.next_flight, None, center), half, beyond))
            if name in DELAYS
            else one
            for name, one in axis.spread.items()
        },
    )


def _summed(error: float, half: float, beyond: Ends) -> float:
    """Standard error with those of the further errors; the variance of a uniform one is a twelfth of its square."""
    return float(np.sqrt(error**2 + (half / NORMAL) ** 2 + sum(one**2 for one in beyond) / 12))


def _combination(one: Combination, half: float, beyond: Ends) -> Combination:
    own = one.ci95_flight and wider(one.ci95_flight, _middle(one.ci95_flight, None, one.value), half, beyond)
    return replace(one, ci95=wider(one.ci95, one.value, half, beyond), ci95_flight=own)


def _middle(ends: Interval, value: float | None, otherwise: float) -> float:
    """Centre of an interval: the published value; without one `otherwise` if it is inside, else the middle.

    An interval with an open end has no middle: its centre is `otherwise`, too.
    """
    low, high = ends
    if value is not None:
        return value
    return otherwise if low is None or high is None or low <= otherwise <= high else 0.5 * (low + high)


def wider(ends: Interval, center: float, half: float, beyond: Ends) -> Interval:
    """An interval with an independent error of its centre added in quadrature to each side, and one to each end."""
    if not half and not any(beyond):
        return ends
    low, high = ends
    shorter, longer = beyond
    return (
        None if low is None else center - float(np.hypot(center - low, half)) - shorter,
        None if high is None else center + float(np.hypot(high - center, half)) + longer,
    )


def narrower(ends: Interval, center: float, half: float, beyond: Ends) -> Interval:
    """The interval that `wider` makes the given one of: what is left, and shrinks as the flight goes on."""
    if not half and not any(beyond):
        return ends
    low, high = ends
    shorter, longer = beyond
    return (
        None if low is None else center - _without(center - low - shorter, half),
        None if high is None else center + _without(high - center - longer, half),
    )


def _without(distance: float, half: float) -> float:
    return float(np.sqrt(max(distance**2 - half**2, 0.0))) if distance > 0 else distance
