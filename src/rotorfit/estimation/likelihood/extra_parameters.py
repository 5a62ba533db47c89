"""Further parameters of a structure: values, errors, intervals, statuses, and combinations with the coefficients."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from rotorfit.core.laws import DELAY_RANGE, FIRST_ORDER_DELAY, Extra, Structure
from rotorfit.core.model import Combination, Interval
from rotorfit.estimation.likelihood.blocks import Record
from rotorfit.estimation.likelihood.fisher_scoring import Optimum
from rotorfit.estimation.likelihood.likelihood import inverted
from rotorfit.estimation.likelihood.profile import height, hold, profile, quantile

WIDEST_RATIO = 6.0
"""Ratio of the ends of the interval of a lag or a saturation level beyond which it is not identifiable."""


def structure_at(optimum: Optimum, k: int) -> Structure:
    """The structure of axis k."""
    structures = optimum.point.structures
    return structures[k] if structures else FIRST_ORDER_DELAY


def estimated_extras(optimum: Optimum, k: int) -> tuple[Extra, ...]:
    """The further parameters of axis k that are estimated."""
    return tuple(extra for extra in structure_at(optimum, k).extras if extra.estimated)


SUM_POINTS = 6
"""Number of lags on either side of the best at which the sum of delay and lag is evaluated."""

LONGEST_LAG = 2.0
"""Upper bound of the lag in the search [s]."""

LEAST_OWN = 1e-6
"""Share of the information about a further parameter that must remain when the other parameters are free."""


def told_apart(optimum: Optimum, k: int) -> bool:
    """Whether each further parameter of axis k is identifiable separately from the other parameters.

    A saturation level and the gain are not where all commands have the same size.
    """
    information = optimum.score.information
    variance = np.diag(inverted(information, optimum.free))
    places = [optimum.point.place(extra.name, k) for extra in estimated_extras(optimum, k)]
    return all(information[i, i] * variance[i] < 1 / LEAST_OWN for i in places)


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
    values, variance = optimum.point.extra_values(k), np.diag(inverted(optimum.score.information, optimum.free))
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


def further_combinations(
    records: Sequence[Record], optimum: Optimum, k: int, ends: Mapping[str, Interval]
) -> dict[str, Combination]:
    """Combinations of the parameters of a structure; `total_lag` only where its formula differs from the default.

    The interval of delay plus lag follows from the profile of the lag, the others from the delta method.

    Args:
        records: The flights.
        optimum: The maximum.
        k: Index of the axis.
        ends: Intervals of its further parameters in the coordinates of the estimator, by name.

    Source: of the second order, T v'' + v' + b v, also with a zero: natural frequency sqrt(b / T), damping ratio
    1 / (2 sqrt(b T)).
    """
    structure, point = structure_at(optimum, k), optimum.point
    g, b, tau = float(point.gain[k]), float(np.exp(point.log_damping[k])), float(point.delay[k])
    value, out = point.extra_values(k), {}

    def said(result: float, positive: bool = True, **slopes: float) -> Combination:
        return _combination(optimum, k, result, positive, slopes)

    if structure.order == 1:
        T = value["lag"]
        out["delay_plus_lag"] = Combination(tau + T, _sum_interval(records, optimum, k, ends["lag"]))
        out["total_lag"] = said(tau + T + 1 / b, False, delay=1.0, lag=T, damping=-1 / b)
    if structure.order == 2:
        T = value["lag"]
        if "zero" in value:
            out["total_lag"] = said(tau + 1 / b - value["zero"], False, delay=1.0, damping=-1 / b, zero=-1.0)
        out["natural_frequency"] = said(float(np.sqrt(b / T)), damping=0.5, lag=-0.5)
        out["damping_ratio"] = said(float(0.5 / np.sqrt(b * T)), damping=-0.5, lag=-0.5)
    if "drag_share" in value:
        m, V = value["drag_share"], value["reference_speed"]
        out["quadratic_drag"] = said(m * b / V, False, damping=m * b / V, drag_share=b / V)
        out["damping_at_rest"] = said(b * (1 - m), False, damping=b * (1 - m), drag_share=-b)
    if "asymmetry" in value:
        s = value["asymmetry"]
        out["input_up"] = said(g * (1 + s), False, input=1 + s, asymmetry=g)
        out["input_down"] = said(g * (1 - s), False, input=1 - s, asymmetry=-g)
    return out


def delay_plus_lag(records: Sequence[Record], optimum: Optimum, k: int) -> Combination:
    """Sum of delay and lag of axis k [s], which may be identifiable where its parts are not; the optimum has both."""
    lag = profile(records, optimum, optimum.point.place("lag", k)).ci95
    total = float(optimum.point.delay[k]) + optimum.point.extra_values(k)["lag"]
    return Combination(total, _sum_interval(records, optimum, k, lag))


def _sum_interval(records: Sequence[Record], optimum: Optimum, k: int, lag: Interval) -> Interval:
    """95 % interval of delay plus lag [s]: the range of the sum over the region that the likelihood allows.

    A delay and a lag trade off along a curve, so the delays are found at several lags of the lag's interval instead of
    by linearisation. Without a delay the interval is that of the lag. `lag` is the interval of its logarithm.
    """
    index, low, high = optimum.point.place("lag", k), *_searched(optimum, k, lag)
    if not structure_at(optimum, k).delayed:
        return (None if lag[0] is None else float(np.exp(low)), None if lag[1] is None else float(np.exp(high)))
    delay, best = optimum.point.place("delay", k), float(optimum.point.flat()[index])
    direction = np.zeros(optimum.point.n)
    direction[delay] = 1.0
    direction[index] = np.exp(best)
    reach, found = quantile(optimum, direction), []
    for targets in (np.linspace(best, low, SUM_POINTS), np.linspace(best, high, SUM_POINTS)):
        here = optimum
        for target in targets:
            here = hold(records, here, index, float(target))
            left = reach**2 - 2 * max(height(optimum) - height(here), 0.0)
            if left < 0:
                break
            spread = float(np.sqrt(left * inverted(here.score.information, here.free)[delay, delay]))
            middle = float(here.point.flat()[delay]) + float(np.exp(target))
            found += [middle - spread, middle + spread]
    # an end outside the range of the search is open
    ends = (DELAY_RANGE[0], DELAY_RANGE[1] + LONGEST_LAG)
    return (None if min(found) < ends[0] else min(found)), (None if max(found) > ends[1] else max(found))


def _searched(optimum: Optimum, k: int, ends: Interval) -> tuple[float, float]:
    """An interval of the logarithm of the lag, with open ends replaced by the bounds of the search."""
    low, high = (float(bound[optimum.point.place("lag", k)]) for bound in optimum.point.bounds())
    return (low if ends[0] is None else ends[0]), (high if ends[1] is None else ends[1])


def _combination(optimum: Optimum, k: int, value: float, logarithmic: bool, slopes: Mapping[str, float]) -> Combination:
    """A combination by the delta method, from its derivatives (or those of its logarithm) by the coordinates."""
    C = inverted(optimum.score.information, optimum.free)
    direction = np.zeros(optimum.point.n)
    for name, slope in slopes.items():
        direction[optimum.point.place(name, k)] = slope
    variance = float(direction @ C[: direction.size, : direction.size] @ direction)
    if variance <= 0:
        return Combination(value, (value, value))
    half = quantile(optimum, direction) * float(np.sqrt(variance))
    if logarithmic:
        ends = (value * float(np.exp(-half)), value * float(np.exp(half))) if half < 2 else (None, None)
        return Combination(value, ends)
    return Combination(value, (value - half, value + half) if half < 2 * abs(value) else (None, None))
