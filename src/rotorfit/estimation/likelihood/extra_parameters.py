"""Further parameters of a structure: values, errors, intervals, statuses."""

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from rotorfit.core.laws import FIRST_ORDER_DELAY, Extra, Structure
from rotorfit.core.model import Interval
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


LEAST_OWN = 1e-6
"""Share of the information about a further parameter that must remain when the other parameters are free."""

NO_INFORMATION = 0.5
"""Information times variance below which there is no information: it is 1 or more, but for the ridge of the inverse."""


def separable(optimum: Optimum, k: int) -> bool:
    """Whether each further parameter of axis k is identifiable separately from the other parameters.

    A saturation level and the gain are not where all commands have the same size, nor is a level that no command
    reaches: of that there is no information at all.
    """
    information = optimum.score.information
    variance = np.diag(inverted(information, optimum.free))
    places = [optimum.point.place(extra.name, k) for extra in estimated_extras(optimum, k)]
    return all(NO_INFORMATION < information[i, i] * variance[i] < 1 / LEAST_OWN for i in places)


@dataclass(frozen=True)
class Further:
    """Published values, standard errors, intervals and statuses of the further parameters of an axis, by name."""

    extra: Mapping[str, float | None]
    stderr: Mapping[str, float | None]
    ci95: Mapping[str, Interval]
    status: Mapping[str, str]


def further(optimum: Optimum, k: int, ends: Mapping[str, Interval]) -> Further:
    """Published values of the further parameters of axis k.

    Args:
        optimum: Maximum under a structure with further parameters.
        k: Index of the axis.
        ends: Their intervals in the coordinates of the estimator, by name; open ends are None.
    """
    values, variance = optimum.point.extra_values(k), np.diag(optimum.covariance)
    extras = structure_at(optimum, k).extras
    ci95 = {extra.name: _interval(extra, ends[extra.name]) for extra in extras if extra.estimated}
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
