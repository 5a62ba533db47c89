"""Further parameters of a structure: values, errors, intervals, statuses."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from rotorfit.core.frames import Array
from rotorfit.core.laws import FIRST_ORDER_DELAY, Extra, Structure
from rotorfit.core.model import NORMAL, Interval
from rotorfit.dynamics.disturbance import stationary
from rotorfit.estimation.likelihood.fisher_scoring import Optimum
from rotorfit.estimation.likelihood.likelihood import inverted

WIDEST_RATIO = 6.0
"""Ratio of the ends of the interval of a lag or a saturation level beyond which it is not identifiable."""


def structure_at(optimum: Optimum, k: int) -> Structure:
    """The structure of axis k."""
    structures = optimum.point.structures
    return structures[k] if structures else FIRST_ORDER_DELAY


def estimated_extras(optimum: Optimum, k: int) -> tuple[Extra, ...]:
    """The further parameters of axis k that are estimated."""
    return tuple(extra for extra in structure_at(optimum, k).extras if extra.estimated)


MOST_GUSTS = 0.15
"""Share of the limit that what gusts make a velocity loop ask for may be, as a standard deviation. On flights with
0.3 (median), 9 of 15 intervals of the input held the truth, with 0.2, 37 of 40; with 0.1, 15 of 15."""

LEAST_OWN = 1e-6
"""Share of the information about a further parameter that must remain when the other parameters are free."""

NO_INFORMATION = 0.5
"""Information times variance below which there is no information: it is 1 or more, but for the ridge of the inverse."""


def separable(optimum: Optimum, k: int) -> bool:
    """Whether each further parameter of axis k is identifiable separately from the other parameters.

    A saturation level and the gain are not where all commands have the same size, nor is a level that no command
    reaches: of that there is no information at all. Nor is a limit that gusts reach, too, which the law counts out.
    """
    information = optimum.score.information
    variance = np.diag(inverted(information, optimum.free))
    if structure_at(optimum, k).limited:
        error = float(np.sqrt(variance[optimum.point.place("acceleration_limit", k)]))
        if _gusts(optimum, k) > MOST_GUSTS or 2 * NORMAL * error > np.log(WIDEST_RATIO):
            return False
    places = [optimum.point.place(extra.name, k) for extra in estimated_extras(optimum, k)]
    return all(NO_INFORMATION < information[i, i] * variance[i] < 1 / LEAST_OWN for i in places)


def _gusts(optimum: Optimum, k: int) -> float:
    """Standard deviation of what axis k asks for against the disturbance's velocity, over its limit."""
    speed = float(np.sqrt(stationary(np.exp(optimum.point.levels[k]))[0]))
    return float(np.exp(optimum.point.log_damping[k])) * speed / optimum.point.extra_values(k)["acceleration_limit"]


VAGUE = 2.0
"""How many times the error of its interval the curvature may give a further parameter before the interval counts."""


def bounded_covariance(optimum: Optimum, ends: Mapping[int, Mapping[str, Interval]]) -> Array:
    """Covariance of the parameters, in which no further parameter is much less certain than its interval says.

    A vanishing zero has the effect of a shorter delay: to first order the data tell only their difference, and the
    inverse of the information is arbitrarily large. The interval, which ends where the second order shows, then bounds
    the zero; what is known of the difference stays.

    Args:
        optimum: The maximum.
        ends: Intervals of the further parameters, by name, of axes by index; an open end is that of the search.
    """
    variance, known = np.diag(optimum.covariance), np.zeros(len(optimum.free))
    for k, intervals in ends.items():
        for extra in estimated_extras(optimum, k):
            i, (low, high) = optimum.point.place(extra.name, k), intervals[extra.name]
            reach = [
                extra.coordinate(edge if end is None else end) for end, edge in ((low, extra.low), (high, extra.high))
            ]
            error = (reach[1] - reach[0]) / (2 * NORMAL)
            if variance[i] > (VAGUE * error) ** 2 > 0:
                known[i] = 1 / error**2
    if not known.any():
        return optimum.covariance
    return inverted(optimum.score.information + np.diag(known), optimum.free)


def conditional_covariance(optimum: Optimum, k: int, names: Sequence[str]) -> Array:
    """Covariance of the parameters for some of axis k as they are.

    Where a lag or zero has nearly the effect of damping or delay, the covariance of all is arbitrarily large and jumps
    from step to step; for the lag and zero as they are it is regular.
    """
    free = optimum.free.copy()
    free[[optimum.point.place(name, k) for name in names]] = False
    return inverted(optimum.score.information, free)


def extra_intervals(optimum: Optimum, k: int, ends: Mapping[str, Interval]) -> dict[str, Interval]:
    """Intervals of the further parameters of axis k from those in the coordinates of the estimator, by name."""
    return {extra.name: _interval(extra, ends[extra.name]) for extra in estimated_extras(optimum, k)}


@dataclass(frozen=True)
class Further:
    """Published values, standard errors, intervals and statuses of the further parameters of an axis, by name."""

    extra: Mapping[str, float | None]
    stderr: Mapping[str, float | None]
    ci95: Mapping[str, Interval]
    status: Mapping[str, str]


def further(optimum: Optimum, k: int, ci95: Mapping[str, Interval], covariance: Array) -> Further:
    """Published values of the further parameters of axis k.

    Args:
        optimum: Maximum under a structure with further parameters.
        k: Index of the axis.
        ci95: From `extra_intervals`.
        covariance: From `bounded_covariance`.
    """
    values, variance = optimum.point.extra_values(k), np.diag(covariance)
    extras = structure_at(optimum, k).extras
    status = {extra.name: extra_status(extra, ci95[extra.name]) for extra in extras if extra.estimated}
    error = {
        extra.name: float(np.sqrt(variance[optimum.point.place(extra.name, k)]))
        * (values[extra.name] if extra.logarithmic else 1.0)
        for extra in extras
        if extra.estimated
    }
    good = {extra.name: status.get(extra.name, "ok") == "ok" for extra in extras}
    return Further(
        extra={name: values[name] if known else None for name, known in good.items()},
        stderr={name: value if good[name] else None for name, value in error.items()},
        ci95=ci95,
        status=status,
    )


def _interval(extra: Extra, ends: Interval) -> Interval:
    low, high = (None if end is None else extra.value(end) for end in ends)
    return low, extra.high if high is None and extra.closed else high


def extra_status(extra: Extra, ends: Interval) -> str:
    """`ok`, or `not_identifiable` where an end is open or the interval of a logarithmic parameter is too wide."""
    low, high = ends
    if low is None or high is None or (extra.logarithmic and high > WIDEST_RATIO * low):
        return "not_identifiable"
    return "ok"
