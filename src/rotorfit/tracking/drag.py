"""The vehicle behind the wind: what this flight tells of it, and what is known of the drag of multirotors.

The stronger the gusts, the less a flight tells of the damping: its maximum likelihood may lie near zero or several
times too high. Input and delay remain known. Where commands are tilts, the damping is the drag of the air, which
differs little between multirotors: the wind is then that of the most probable vehicle under a log-normal prior of the
drag, and its interval includes how far the vehicle may be from it. So are velocity and prediction; coefficients, models
and alarms are those of the flight alone.

The likelihood counts for as much as its interval says. In strong gusts and a feedback loop the expected information
overstates what is known; the profile interval does not, so the prior is weighted with the square of their ratio.

Source: S. M. Kay, Fundamentals of Statistical Signal Processing: Estimation Theory (1993), section 11.5.
"""

from collections.abc import Mapping
from dataclasses import replace

import numpy as np

from rotorfit.core.card import Card
from rotorfit.core.limits import meaning_of
from rotorfit.core.model import COEFFICIENTS, NORMAL, Interval
from rotorfit.estimation.likelihood.axis_estimate import Estimate
from rotorfit.estimation.likelihood.coefficients import statuses
from rotorfit.estimation.likelihood.estimand import estimands, half_widths
from rotorfit.estimation.likelihood.fisher_scoring import Optimum, maximise
from rotorfit.estimation.likelihood.likelihood import inverted
from rotorfit.estimation.likelihood.prior import GaussianPrior, with_prior

DRAG_MEDIAN = 0.25
"""Median of the prior of the drag [1/s]: the room's vehicles of published drag have 0.10 to 0.53, recorded flights of
Bebop 2 0.15 to 0.27."""

DRAG_SPREAD = 0.6
"""Standard deviation of its logarithm, somewhat larger than theirs: 95 % of the prior is from 0.08 to 0.81 1/s."""

OPEN = 2.0
"""Least factor by which the information overstates what is known of a coefficient whose interval has an open end. In
40 estimates in gusts of 5 m/s and a feedback loop, the logarithm of the damping is off by 2 of its standard errors."""

TOLERANCE = 0.01
"""Expected gain in log-likelihood of one more step below which the climb stops: some 0.1 standard errors."""

Ends = Mapping[str, Interval]
"""Quantity to the 95 % interval of an axis."""


def is_drag(card: Card, axis: str) -> bool:
    """Whether the damping of an axis is the drag of the air: its commands are tilts."""
    return meaning_of(card, axis).asked == "tilt"


def with_drag(card: Card, estimates: Mapping[str, Estimate], own: Mapping[str, Ends]) -> dict[str, Estimate]:
    """The most probable vehicle: estimates of tilted axes under the prior of the drag, the others as they are.

    Args:
        card: The vehicle's.
        estimates: Axis name to its estimate.
        own: Axis name to the intervals of this flight.
    """
    axes: dict[int, list[str]] = {}
    for axis, one in estimates.items():
        if is_drag(card, axis) and one.records:
            axes.setdefault(id(one.optimum), []).append(axis)
    out = dict(estimates)
    for shared in axes.values():
        first = estimates[shared[0]]
        weights = {estimates[axis].place: widening(estimates[axis], own.get(axis, {}))["damping"] for axis in shared}
        optimum = _under_prior(first, weights)
        out |= {axis: replace(estimates[axis], optimum=optimum) for axis in shared}
    return out


def _under_prior(estimate: Estimate, weights: Mapping[int, float]) -> Optimum:
    """The maximum of likelihood and prior, the levels unmoved.

    Args:
        estimate: Of one axis of the likelihood.
        weights: Place of each tilted axis to the factor by which its damping is less certain than the information says.
    """
    optimum, point = estimate.optimum, estimate.optimum.point
    mean, given, added = np.zeros((3, point.coefficients))
    if optimum.prior is not None:
        size = optimum.prior.mean.size
        mean[:size], given[:size] = optimum.prior.mean, optimum.prior.precision
    log_damping = point.log_damping.copy()
    for k, weight in weights.items():
        i = point.place("damping", k)
        if given[i] == 0.0:  # else the card knows this vehicle
            mean[i], added[i] = np.log(DRAG_MEDIAN), (weight / DRAG_SPREAD) ** 2
            reach = NORMAL * DRAG_SPREAD  # near zero the likelihood is flat in the logarithm
            log_damping[k] = np.clip(log_damping[k], mean[i] - reach, mean[i] + reach)
    free = optimum.free.copy()
    free[point.n :] = False
    prior, known = GaussianPrior(mean, given + added), with_prior(optimum.score, point, GaussianPrior(mean, added))
    rise = 0.5 * float(known.gradient @ inverted(known.information, free) @ known.gradient)
    if rise < TOLERANCE and np.array_equal(log_damping, point.log_damping):
        return replace(optimum, score=known, prior=prior)  # the flight tells the drag: no pass over it is needed
    start = replace(point, log_damping=log_damping)
    found = maximise(estimate.records, start, free, tolerance=TOLERANCE, prior=prior)
    return replace(found, free=optimum.free)


def widening(estimate: Estimate, ends: Ends) -> dict[str, float]:
    """Half width of the interval of each coefficient over that which the information implies.

    It is at least 1, and at least `OPEN` where the interval has an open end; 1 without an interval.

    Args:
        estimate: Of the flight alone.
        ends: Its intervals.
    """
    told, out = estimands(estimate.optimum, estimate.place), dict.fromkeys(COEFFICIENTS, 1.0)
    for name in out.keys() & told.keys() & ends.keys():
        halves = half_widths(told[name], ends[name])
        widest = max((half for half in halves if half is not None), default=0.0)
        implied = max(NORMAL * told[name].error(estimate.optimum), 1e-9)
        out[name] = max(widest / implied, OPEN if None in halves else 1.0)
    return out


def damping_interval(estimate: Estimate, widened: Mapping[str, float]) -> Interval:
    """The 95 % interval of the damping of an estimate under the prior [1/s].

    Args:
        estimate: From `with_drag`.
        widened: From `widening`.
    """
    one = estimands(estimate.optimum, estimate.place)["damping"]
    reach = float(np.exp(NORMAL * widened["damping"] * one.error(estimate.optimum)))
    return one.value / reach, one.value * reach


def tells_wind(own: Ends, drag: bool) -> bool:
    """Whether this flight tells enough of the vehicle for its wind: the damping, or input and delay where it is drag.

    Args:
        own: Intervals of this flight.
        drag: Whether the damping is drag.
    """
    told = statuses({name: own.get(name, (None, None)) for name in COEFFICIENTS})
    return told["damping"] == "ok" or (drag and told["input"] == told["delay"] == "ok")
