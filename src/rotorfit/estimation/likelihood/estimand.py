"""Estimands: coefficients and combinations, on the scales on which flights of a vehicle are compared."""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from functools import partial

import numpy as np

from rotorfit.core.frames import Array
from rotorfit.core.model import Interval
from rotorfit.dynamics.transfer_function import has_transfer_function
from rotorfit.estimation.likelihood.extra_parameters import estimated_extras, structure_at
from rotorfit.estimation.likelihood.fisher_scoring import Optimum
from rotorfit.estimation.likelihood.parameters import Point


@dataclass(frozen=True)
class Estimand:
    """A coefficient, a further parameter or a combination of an axis at an optimum.

    Attributes:
        name: Name in the model file.
        value: Value in its own unit.
        logarithmic: Whether its scale is the logarithm of its absolute value; else its scale is the value itself.
        slope: Derivative of its scale with respect to the parameters of the estimator, shape (n,).
    """

    name: str
    value: float
    logarithmic: bool
    slope: Array

    def error(self, optimum: Optimum, covariance: Array | None = None) -> float:
        """Standard error on its scale, from the expected information, or from another covariance of the parameters."""
        known = optimum.covariance if covariance is None else covariance
        known = known[: self.slope.size, : self.slope.size]
        return float(np.sqrt(max(float(self.slope @ known @ self.slope), 0.0)))

    def scaled(self) -> float:
        """The value on its scale."""
        return math.log(abs(self.value)) if self.logarithmic else self.value


def estimands(optimum: Optimum, k: int) -> dict[str, Estimand]:
    """Every quantity of axis k that is published with an interval and compared between flights, by name.

    Steady gain and total lag are those of a linear axis that moves by its own command alone: under another law they
    depend on the size of the command, or on the other axis.

    Source: of the second order, T v'' + v' + b v, also with a zero: natural frequency sqrt(b / T), damping ratio
    1 / (2 sqrt(b T)); for the total lag see `core.laws`.
    """
    point, structure = optimum.point, structure_at(optimum, k)
    g, b, tau = float(point.gain[k]), float(np.exp(point.log_damping[k])), float(point.delay[k])
    extra, along = point.extra_values(k), partial(gradient, point, k)
    # under a second-order law the lag does not enter the total lag, and a zero reduces it
    passed = (2 if structure.twice else 1) if structure.order == 1 else 0
    lag, zero = passed * extra.get("lag", 0.0), extra.get("zero", 0.0)
    late = {"lag": lag} if structure.order == 1 else {"zero": -1.0} if "zero" in extra else {}
    out = [
        Estimand("input", g, True, along(input=1 / g)),
        Estimand("damping", b, True, along(damping=1.0)),
        Estimand("delay", tau, False, along(delay=1.0)),
    ]
    if has_transfer_function(structure) or structure.limited:
        out += [
            Estimand("steady_gain", g / b, True, along(input=1 / g, damping=-1.0)),
            Estimand("total_lag", tau + lag + 1 / b - zero, False, along(delay=1.0, damping=-1 / b, **late)),
        ]
    out += [
        Estimand(e.name, extra[e.name], e.logarithmic, along(**{e.name: 1.0})) for e in estimated_extras(optimum, k)
    ]
    if structure.order == 1:
        out.append(Estimand("delay_plus_lag", tau + lag, False, along(delay=1.0, lag=lag)))
    if structure.order == 2:
        T = extra["lag"]
        out += [
            Estimand("natural_frequency", math.sqrt(b / T), True, along(damping=0.5, lag=-0.5)),
            Estimand("damping_ratio", 0.5 / math.sqrt(b * T), True, along(damping=-0.5, lag=-0.5)),
        ]
    return {one.name: one for one in out if structure.delayed or one.name != "delay"}


def gradient(point: Point, k: int, **slopes: float) -> Array:
    """Derivative with respect to all parameters of the estimator, shape (n,), from those to some of axis k, by name."""
    out = np.zeros(point.n)
    for name, slope in slopes.items():
        out[point.place(name, k)] = slope
    return out


def half_widths(estimand: Estimand, ends: Interval) -> Interval:
    """Distances of the ends of an interval below and above the value, on its scale; None for an open end.

    A logarithmic scale is that of the absolute value: for a negative value the upper end of the interval is the lower
    one on the scale.
    """
    low, high = ends
    if not estimand.logarithmic:
        return (None if low is None else estimand.value - low, None if high is None else high - estimand.value)
    if estimand.value < 0:
        low, high = (None if high is None else -high), (None if low is None else -low)
    size = abs(estimand.value)
    return (
        None if low is None or low <= 0 else float(np.log(size / low)),
        None if high is None or high <= 0 else float(np.log(high / size)),
    )


def interval(estimand: Estimand, shift: float, half: Interval) -> Interval:
    """The interval around the shifted value with given half widths below and above; shift and widths on its scale."""
    below, above = half
    center = moved(estimand, shift)
    if not estimand.logarithmic:
        return (None if below is None else center - below, None if above is None else center + above)
    near = None if below is None else center * float(np.exp(-below))
    far = None if above is None else center * float(np.exp(above))
    return (near, far) if estimand.value > 0 else (far, near)


def moved(estimand: Estimand, shift: float) -> float:
    """The value after a shift on its scale."""
    return estimand.value * float(np.exp(shift)) if estimand.logarithmic else estimand.value + shift


def hull(intervals: Sequence[Interval]) -> Interval:
    """The smallest interval that contains all of them; an open end stays open."""
    lows, highs = [low for low, _ in intervals], [high for _, high in intervals]
    return (
        None if None in lows else min(low for low in lows if low is not None),
        None if None in highs else max(high for high in highs if high is not None),
    )
