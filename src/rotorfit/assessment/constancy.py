"""Whether the coefficients stay what they are within a flight: fitted to its parts, are they the same?

How often commands say something: a model's errors average out over events, and over one event they do not.

A likelihood counts every pose, and each of them tells of the one tap of a stick that the flight holds. Its interval is
right if the model is; what the model leaves out is another thing at the next tap, and only several of them show it.
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np

from rotorfit.core.finding import Finding
from rotorfit.core.flight_data import Flight
from rotorfit.core.frames import AXES, Array
from rotorfit.core.results import Fit, student_quantile
from rotorfit.estimation.likelihood.axis_estimate import Estimate
from rotorfit.estimation.likelihood.blocks import record
from rotorfit.estimation.likelihood.fisher_scoring import maximise
from rotorfit.estimation.likelihood.likelihood import inverted
from rotorfit.estimation.likelihood.optima import between, start_point

LEVEL = 1e-4
"""Level of the chi-square test: with four axes 1 flight in 2500 by chance, and room for intervals that are too narrow:
those of the delay are ragged."""

LEAST_CHANGE = 0.1
"""Change of the input gain or the damping, as a share, or ten times that of the delay in seconds, that is said."""

SHORTEST = 15.0
"""Shortest part of a flight that is fitted by itself [s]."""

DAMPINGS = (0.02, 50.0)
"""Dampings [1/s] beyond which a part is said not to tell: the test knows no bounds."""


@dataclass(frozen=True)
class Part:
    """The coefficients of one part of a flight, at the disturbance levels of the whole fit.

    Attributes:
        start: [s].
        end: [s].
        theta: g, log b, tau, shape (3,).
        covariance: Of theta, shape (3, 3).
    """

    start: float
    end: float
    theta: Array
    covariance: Array


@dataclass(frozen=True)
class Constancy:
    """The test that the parts of the flights have one set of coefficients.

    Attributes:
        parts: As fitted.
        chi_square: Sum of the squared deviations from their weighted mean.
        degrees: Of freedom.
        probability: Of a larger one, if the coefficients are the same.
    """

    parts: tuple[Part, ...]
    chi_square: float
    degrees: int
    probability: float


def changed_coefficients(fit: Fit, axis: str) -> Iterator[Finding]:
    """The finding that the coefficients of an axis change within the flights, where they do.

    Args:
        fit: By the likelihood; the paper's method has no parts.
        axis: Which.
    """
    estimate = fit.estimates.get(axis)
    if estimate is None or fit.model.axes[axis].predictor is None:
        return
    serving = [f for f, s in zip(fit.flights, fit.model.flights, strict=True) if axis in s.axes]
    found = constancy(serving, estimate, axis)
    if found is None or found.probability > LEVEL:
        return
    gains, dampings, delays = np.array([[p.theta[0], np.exp(p.theta[1]), p.theta[2]] for p in found.parts]).T
    change = max(np.ptp(gains) / abs(gains.mean()), np.ptp(dampings) / dampings.mean(), 10 * np.ptp(delays))
    if change < LEAST_CHANGE:
        return
    told = "; ".join(
        f"{p.start:.0f} to {p.end:.0f} s: {g:.3g}, {b:.3g} 1/s, {tau:.3f} s"
        for p, g, b, tau in zip(found.parts, gains, dampings, delays, strict=True)
    )
    yield Finding(
        "coefficients_change",
        "warning",
        f"input gain, damping and delay of {axis} differ between halves of the flights ({told}): chi-square "
        f"{found.chi_square:.0f} with {found.degrees} degrees of freedom, by chance in {found.probability:.0e}",
        f"the coefficients of {axis} are a mean over what changes; their intervals are of that mean",
        "look for what changed: battery, limits, speed range, a clock that drifts; fit each part by --span",
        axis,
    )


def constancy(flights: Sequence[Flight], estimate: Estimate, axis: str) -> Constancy | None:
    """Tests whether both halves of each flight have the same coefficients.

    Each half is fitted by itself from the whole fit's point, with a trim and start velocities of its own, at the
    disturbance levels of the whole fit: one yardstick for all.

    Args:
        flights: Those that move the axis.
        estimate: Of the axis, alone or x with y.
        axis: Which.

    Returns:
        The test; None where fewer than two halves are long enough or tell their coefficients.

    Source: the chi-square test of homogeneity of independent estimates; W. G. Cochran, Biometrics 10 (1954), p. 101.
    """
    from scipy.special import chdtrc

    halves = [half for flight in flights for half in _halves(flight)]
    parts = [part for half in halves if (part := _fitted(half, estimate, axis))]
    if len(parts) < 2:
        return None
    weights = [np.linalg.inv(part.covariance) for part in parts]
    mean = np.linalg.solve(sum(weights), sum(w @ p.theta for w, p in zip(weights, parts, strict=True)))
    square = sum(float((p.theta - mean) @ w @ (p.theta - mean)) for w, p in zip(weights, parts, strict=True))
    degrees = 3 * (len(parts) - 1)
    return Constancy(tuple(parts), square, degrees, float(chdtrc(degrees, square)))


def _halves(flight: Flight) -> list[Flight]:
    start, end = flight.segments[0].start, flight.segments[-1].end
    middle = (start + end) / 2
    spans = ((start, middle), (middle, end))
    return [between(flight, *span) for span in spans] if middle - start >= SHORTEST else []


def _fitted(flight: Flight, estimate: Estimate, axis: str) -> Part | None:
    """The coefficients of a part; None where it is too short or does not tell them."""
    axes, k, whole = estimate.records[0].axes, estimate.place, estimate.optimum.point
    rec, K = record(flight, axes), len(axes)
    if rec is None or not np.any(np.diff(rec.command[:, axes.index(axis)])):
        return None
    point = replace(
        start_point([rec], 0.0, 1.0, whole.levels),
        gain=whole.gain,
        log_damping=whole.log_damping,
        delay=whole.delay,
        structures=whole.structures,
        extra=whole.extra,
    )
    free = np.arange(point.flat().size) < point.n
    free[: whole.coefficients] = estimate.optimum.free[: whole.coefficients]
    optimum = maximise([rec], point, free)
    at = [k, K + k, 2 * K + k]
    theta = optimum.point.flat()[at]
    variance = inverted(optimum.score.information, optimum.free)[np.ix_(at, at)]
    told = np.log(DAMPINGS[0]) < theta[1] < np.log(DAMPINGS[1]) and np.all(np.diag(variance) > 0)
    known = np.sqrt(variance[0, 0]) < 0.5 * abs(theta[0]) and np.sqrt(variance[1, 1]) < 1.0
    return Part(*flight.span, theta, variance) if told and known else None


NORMAL = 1.959964
"""97.5 % point of the normal distribution."""

EVENT = 1.0
"""Changes of a command within this time are one event [s]: the horizon by which models are judged, and the reach of the
tests of residuals. A tap, on and off, is one; a step that is held for longer, on and off, is two."""

ONE = 1.5
"""Events below which there is one: nothing can be told of how it differs from the next."""

TWICE = 2.0
"""How many times wider Student's interval over the events is, against that of many, from which on they are few."""


def command_events(flights: Sequence[Flight], axis: str) -> float:
    """How many events of equal size the commands of an axis are worth.

    Windows of `EVENT` begin at the first change outside of the one before; the size of an event is the range of the
    command in it, w its square, and the number is (sum w)^2 / sum w^2. Small corrections beside one large event count
    for little.

    Source: effective number of weighted observations: L. Kish, Survey Sampling (1965), section 11.7.

    Args:
        flights: That command the axis.
        axis: Name.
    """
    weights = np.concatenate([np.zeros(0), *(_ranges(f.command_time, f.command[:, AXES.index(axis)]) for f in flights)])
    weights = weights**2
    return float(weights.sum() ** 2 / (weights**2).sum()) if weights.any() else 0.0


def _ranges(time: Array, command: Array) -> Array:
    """Range of a held command in each window that begins with a change."""
    changes = np.flatnonzero(np.diff(command)) + 1
    ranges, first = [], 0
    while first < changes.size:
        end = int(np.searchsorted(time[changes], time[changes[first]] + EVENT))
        ranges.append(float(np.ptp(command[[changes[first] - 1, *changes[first:end]]])))
        first = end
    return np.array(ranges)


def widening(events: float) -> float:
    """How many times wider an interval over so many events is than the normal one, if what a model leaves out is
    another thing at each event; infinite for one.
    """
    return student_quantile(events - 1) / NORMAL if events >= ONE else float("inf")
