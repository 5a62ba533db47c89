"""Fit -> findings: flights that disagree, and those that stand out: by their conditions, units, clocks or signs."""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from rotorfit.assessment.mismatch import UNITS
from rotorfit.assessment.uncertainty import serving_flights
from rotorfit.core.finding import Finding
from rotorfit.core.frames import Array
from rotorfit.core.model import Spread
from rotorfit.core.plain import listed
from rotorfit.core.results import Fit
from rotorfit.estimation.fitting import estimate_group
from rotorfit.estimation.judgement.each_flight import each_flight
from rotorfit.estimation.likelihood.axis_estimate import Estimate
from rotorfit.estimation.likelihood.blocks import Record
from rotorfit.estimation.likelihood.estimand import estimands

DISAGREE = 0.01
"""Probability that flights that agree are reported to disagree, over all axes of a fit."""

STANDS_OUT = 2.5
"""Distance from the other flights, in standard deviations of such a distance, above which a flight is named."""

UNLIKE = 1.5
"""Ratio to the median of the other flights above which a condition counts as different."""

WITHIN_ONE = (
    "if the answer depends on the size or speed of the commands, the flights differ like this, too: a flight with "
    "small and large, slow and fast ones shows it, since the law is tested within flights; "
)
"""Remedy where flights differ that were flown by unlike commands."""

QUANTITIES = 4
"""Number of independent quantities of an axis, for the level of a test of the worst of them."""

OTHER_UNIT = 5.0
"""Ratio of gains from which on no payload or setting of one vehicle explains it."""

LATE = 0.05
"""Shift of the answers of several axes from which on it may be one of clocks [s]: below it settings may do it."""

ALIKE = 0.25
"""Largest relative difference of the shifts of axes that count as one."""

CERTAIN = 3.0
"""Standard errors from which on the sign of a gain counts."""


def disagreement_findings(fit: Fit) -> Iterator[Finding]:
    """Axes on which the flights disagree, and the flights that stand out, the furthest first."""
    found = {name: worst for name in fit.estimates if (worst := _most_unlike(fit.model.axes[name].spread))}
    late = _late(fit)
    for name, quantity in found.items():
        spread = fit.model.axes[name].spread[quantity]
        if spread.p_value is None or spread.p_value * QUANTITIES > DISAGREE / len(found):
            continue
        values = ", ".join("-" if one is None else f"{_plain(one[0], spread):.3g}" for one in spread.each)
        lines = _standing_out(fit, name, spread)
        flown = _flown_unlike(fit, name, spread)
        cause = (
            _clocks(late) if name in {axis for axes, _ in late.values() for axis in axes} else _units(quantity, spread)
        )
        yield Finding(
            "flights_disagree",
            "warning" if spread.flights_sd and spread.flights_sd > spread.prior_sd else "info",
            f"the {spread.flights} flights that determine {name} differ by more than their own errors, most in "
            f"{quantity.replace('_', ' ')}: {values} (p = {spread.p_value:.1g})"
            + "".join(f"; {line}" for line in (*lines, *flown)),
            f"the intervals of {name} are of the vehicle's mean over such flights; on the next one "
            f"{quantity.replace('_', ' ')} lies in {_ends(spread)}",
            cause
            or (WITHIN_ONE if flown else "")
            + "compare settings, units, payload, battery and wind of the flights that stand out, which may be another "
            "vehicle's; what cannot be explained is in the intervals",
            name,
        )


def turned_findings(fit: Fit) -> Iterator[Finding]:
    """Axes whose command moves the vehicle one way in some flights and the other way in others.

    The logarithm of a gain does not tell them, so that the spread between flights leaves flights out, and the gain of
    all together may be nothing.
    """
    for name, estimate in fit.estimates.items():
        gains = _certain_gains(fit, name) if len(estimate.records) > 1 else []
        told = [
            listed([f"{path} ({gain:.3g})" for path, gain in gains if (gain > 0) == forwards])
            for forwards in (False, True)
        ]
        if not all(told):
            continue
        yield Finding(
            "sign_flipped",
            "error",
            "a positive command of {} moves it backwards in {} and forwards in {}, by the steady gain of each flight "
            "alone".format(name, *told),
            f"what is told of {name} is a mean of two signs, and of no vehicle",
            f"leave the flights of the wrong sign out, or write their logs anew with {name} of the commands turned, as "
            "one card serves all flights of a fit; a clock that is off by half a period of the commands looks alike",
            name,
        )


def _certain_gains(fit: Fit, name: str) -> list[tuple[str, float]]:
    """Path and steady gain of the flights that certainly tell its sign, where one of them tells no logarithm."""
    estimate, axis = fit.estimates[name], fit.model.axes[name]
    spread = axis.spread.get("steady_gain") or axis.spread.get("input")
    if axis.predictor and spread and all(spread.each):
        return []
    paths = [fit.flights[place].path for place in serving_flights(fit, estimate)]
    out = []
    for path, one in zip(paths, _alone(fit, name), strict=True):
        gain = estimands(one.optimum, one.place).get("steady_gain") if one else None
        if one and gain and gain.error(one.optimum) < 1 / CERTAIN:
            out.append((path, gain.value))
    return out


def _alone(fit: Fit, name: str) -> list[Estimate | None]:
    """The estimate from each flight alone, sought anew where all together do not excite the axis."""
    estimate = fit.estimates[name]
    if estimate.excited:
        return each_flight(estimate)
    flights = [fit.flights[place] for place in serving_flights(fit, estimate)]
    sought = [estimate_group([flight], estimate.records[0].axes, {}).get(name) for flight in flights]
    return [one if one and one.excited else None for one in sought]  # without a gain there is no logarithm of it


def _late(fit: Fit) -> dict[str, tuple[list[str], float]]:
    """Flights whose answers are late, or early, by the same time on several axes: path to axes and time [s]."""
    shifts: dict[str, dict[str, float]] = {}
    for name, estimate in fit.estimates.items():
        spread = fit.model.axes[name].spread.get("total_lag")
        each = spread.each if spread else ()
        if sum(map(bool, each)) < 3:
            continue
        places = serving_flights(fit, estimate)
        for i, _, shift, distance in _distances(each):
            if distance > STANDS_OUT and abs(shift) > LATE:
                shifts.setdefault(fit.flights[places[i]].path, {})[name] = shift
    out = {}
    for path, found in shifts.items():
        middle = float(np.median(list(found.values())))
        if len(found) > 1 and all(abs(one - middle) < ALIKE * abs(middle) for one in found.values()):
            out[path] = list(found), middle
    return out


def _clocks(late: Mapping[str, tuple[list[str], float]]) -> str:
    """Remedy where clocks explain the difference."""
    told = [
        f"the answers of {listed(axes)} of {path.rsplit('/', 1)[-1]} come {abs(time):.2f} s "
        f"{'later' if time > 0 else 'earlier'} alike, as where poses and commands have two clocks"
        for path, (axes, time) in late.items()
    ]
    return f"{'; '.join(told)}: look at its stamps first; else it is of another vehicle"


def _units(quantity: str, spread: Spread) -> str:
    """Remedy where a gain differs by more than any vehicle does; empty where it does not."""
    known = [one[0] for one in spread.each if one]
    if quantity not in ("input", "steady_gain") or max(known) - min(known) < np.log(OTHER_UNIT):
        return ""
    return (
        f"compare units and scales of the flights in [command] and [pose] first, and their clocks: {UNITS}; no payload "
        "changes a gain so much"
    )


def _flown_unlike(fit: Fit, name: str, spread: Spread) -> list[str]:
    """In what the commands of the flights differ that determine an axis, in the order of their values."""
    flown = _all_conditions(fit.estimates[name])
    out = []
    for part, word in (("size", "size"), ("quickness", "number of changes a second")):
        values = [getattr(flown[i], part) for i, one in enumerate(spread.each) if one is not None]
        if max(values) > UNLIKE * min(values):
            out.append(f"their commands differ in {word}: {', '.join(f'{value:.2g}' for value in values)}")
    return out


def _most_unlike(spreads: Mapping[str, Spread]) -> str | None:
    told = {name: one.p_value for name, one in spreads.items() if one.p_value is not None}
    return min(told, key=lambda name: told[name]) if told else None


def _plain(value: float, spread: Spread) -> float:
    return float(np.exp(value)) if spread.logarithmic else value


def _ends(spread: Spread) -> str:
    low, high = spread.next_flight
    return " to ".join("open" if end is None else f"{end:.3g}" for end in (low, high))


@dataclass(frozen=True)
class Conditions:
    """Conditions of a flight, for one axis, as far as its log shows them.

    Attributes:
        size: Root mean square of the command about its median.
        quickness: Number of equivalent command events per second.
        disturbance: Root mean square of the innovations at the levels of all flights: wind and noise.
    """

    size: float
    quickness: float
    disturbance: float


def conditions(rec: Record, innovation: Array, k: int) -> Conditions:
    """Conditions of one flight and axis; `innovation` (B,) at the levels of all flights."""
    command = rec.command[:, k]
    change = np.abs(np.diff(command))
    jumps = float(change.sum() ** 2 / np.sum(change**2)) if change.any() else 0.0
    return Conditions(
        size=float(np.sqrt(np.mean((command - np.median(command)) ** 2))),
        quickness=jumps / float(np.ptp(rec.command_time)),
        disturbance=float(np.sqrt(np.mean(innovation**2))),
    )


def _standing_out(fit: Fit, name: str, spread: Spread) -> list[str]:
    """A line for each flight far from the others, the furthest first, with the conditions that differ."""
    estimate, each = fit.estimates[name], spread.each
    if sum(map(bool, each)) < 3:
        return []
    flown = _all_conditions(estimate)
    places = serving_flights(fit, estimate)
    lines = []
    for i, value, _, distance in _distances(each):
        if distance > STANDS_OUT:
            path = fit.flights[places[i]].path.rsplit("/", 1)[-1]
            unlike = _unlike(flown[i], [one for j, one in enumerate(flown) if j != i])
            lines.append((distance, f"{path} stands out ({_plain(value, spread):.3g}): {unlike}"))
    return [line for _, line in sorted(lines, reverse=True)]


def _distances(each: Sequence[tuple[float, float] | None]) -> Iterator[tuple[int, float, float, float]]:
    """Of each flight that tells a quantity: its place, its value, that less the median of the others, and this
    difference over its standard deviation."""
    told = [i for i, one in enumerate(each) if one is not None]
    known = np.array([each[i] for i in told])
    for row, i in enumerate(told):
        others = np.delete(known, row, axis=0)
        middle = float(np.median(others[:, 0]))
        apart = float(np.median(np.abs(others[:, 0] - middle))) * 1.4826
        value, error = map(float, known[row])
        shift = value - middle
        yield i, value, shift, abs(shift) / float(np.sqrt(error**2 + apart**2 + np.median(others[:, 1]) ** 2))


def _all_conditions(estimate: Estimate) -> list[Conditions]:
    pairs = zip(estimate.records, estimate.optimum.score.innovations, strict=True)
    return [conditions(rec, innovation[:, estimate.place], estimate.place) for rec, innovation in pairs]


_WORDS = {
    "size": ("larger commands", "smaller commands"),
    "quickness": ("smoother commands", "fewer and larger steps"),
    "disturbance": ("more wind or noise", "less wind or noise"),
}


def _unlike(one: Conditions, others: list[Conditions]) -> str:
    """Conditions in which a flight differs from the others, the largest difference first."""
    ratios = {}
    for part in _WORDS:
        middle = float(np.median([getattr(other, part) for other in others]))
        ratios[part] = getattr(one, part) / middle if middle > 0 else 1.0
    ranked = sorted(ratios, key=lambda part: -abs(np.log(max(ratios[part], 1e-9))))
    said = [
        f"{_WORDS[part][ratios[part] < 1]} ({ratios[part]:.2g} times)"
        for part in ranked
        if not 1 / UNLIKE < ratios[part] < UNLIKE
    ]
    return ", ".join(said) or "commands and wind like those of the others: look at settings, payload, battery"
