"""Combinations of an axis' parameters, as published: steady gain, total lag, and those of further parameters."""

from collections.abc import Mapping, Sequence

import numpy as np

from rotorfit.core.laws import DELAY_RANGE
from rotorfit.core.model import Combination, Interval
from rotorfit.estimation.likelihood.blocks import Record
from rotorfit.estimation.likelihood.estimand import Estimand, estimands, gradient, interval
from rotorfit.estimation.likelihood.extra_parameters import structure_at
from rotorfit.estimation.likelihood.fisher_scoring import Optimum
from rotorfit.estimation.likelihood.likelihood import inverted
from rotorfit.estimation.likelihood.profile import height, hold, profile, quantile

SUM_POINTS = 6
"""Number of lags on either side of the best at which the sum of delay and lag is evaluated."""

LONGEST_LAG = 2.0
"""Upper bound of the lag in the search [s]."""

WIDEST = 2.0
"""Half width from which on an interval is open, on a logarithmic scale; on others as a multiple of the value."""

BY_DELTA = ("steady_gain", "total_lag", "natural_frequency", "damping_ratio")
"""Combinations with an interval by the delta method, as far as the law has them."""


def combinations(
    records: Sequence[Record], optimum: Optimum, k: int, ends: Mapping[str, Interval]
) -> dict[str, Combination]:
    """Combinations of the parameters of axis k under its law.

    The interval of delay plus lag follows from the profile of the lag, the others from the delta method.

    Args:
        records: The flights.
        optimum: The maximum.
        k: Index of the axis.
        ends: Intervals of its further parameters in the coordinates of the estimator, by name.
    """
    point, known = optimum.point, estimands(optimum, k)
    g, b, value = float(point.gain[k]), float(np.exp(point.log_damping[k])), point.extra_values(k)
    out = {name: _by_delta(optimum, known[name]) for name in BY_DELTA if name in known}
    if "delay_plus_lag" in known:
        sum_ends = _sum_interval(records, optimum, k, ends["lag"])
        out["delay_plus_lag"] = Combination(known["delay_plus_lag"].value, sum_ends)

    def add(name: str, result: float, **slopes: float) -> None:
        out[name] = _by_delta(optimum, Estimand(name, result, False, gradient(point, k, **slopes)))

    if "drag_share" in value:
        m, V = value["drag_share"], value["reference_speed"]
        add("quadratic_drag", m * b / V, damping=m * b / V, drag_share=b / V)
        add("damping_at_rest", b * (1 - m), damping=b * (1 - m), drag_share=-b)
    if "asymmetry" in value:
        s = value["asymmetry"]
        add("input_up", g * (1 + s), input=1 + s, asymmetry=g)
        add("input_down", g * (1 - s), input=1 - s, asymmetry=-g)
    return out


def _by_delta(optimum: Optimum, one: Estimand) -> Combination:
    """A combination with its interval by the delta method on its scale."""
    error = one.error(optimum)
    if not error:
        return Combination(one.value, (one.value, one.value))
    half = quantile(optimum, one.slope) * error
    narrow = half < WIDEST * (1.0 if one.logarithmic else abs(one.value))
    return Combination(one.value, interval(one, 0.0, (half, half)) if narrow else (None, None))


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
