"""Whether the coefficients stay the same within a flight: its halves are fitted separately and compared.

Halves of different flights are not compared: how much flights differ is in the spread between them.

Also how many events the commands hold: a model's errors average out over events, and with one event they do not.

A likelihood counts every pose, even if all of them show the response to the only stick tap of the flight. Its interval
is right if the model is; what the model leaves out changes from tap to tap, and only several taps show it.
"""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from rotorfit.core.finding import Finding
from rotorfit.core.flight_data import Flight
from rotorfit.core.frames import AXES, Array
from rotorfit.core.model import NORMAL
from rotorfit.core.results import Fit, student_quantile
from rotorfit.estimation.likelihood.axis_estimate import Estimate
from rotorfit.estimation.likelihood.blocks import Record, record
from rotorfit.estimation.likelihood.fisher_scoring import Optimum, maximise
from rotorfit.estimation.likelihood.optima import between, start_point
from rotorfit.estimation.likelihood.parameters import Point
from rotorfit.estimation.likelihood.prior import prior_of_law
from rotorfit.estimation.zero_command import commanded_parts

LEVEL = 1e-4
"""Level of the chi-square test: with four axes, 1 flight in 2500 by chance. It allows for intervals that are too
narrow, as those of the delay can be."""

LEAST_CHANGE = 0.1
"""Smallest change reported: relative, of the input gain or damping; ten times that of the delay in seconds."""

SHORTEST = 15.0
"""Shortest part of a flight that is fitted separately [s]."""

DAMPINGS = (0.02, 50.0)
"""Range of dampings [1/s] outside which a part is left out: the test knows no bounds."""


@dataclass(frozen=True)
class Part:
    """The coefficients of one part of a flight, at the disturbance levels of the whole fit.

    Attributes:
        start: Start of the part [s].
        end: End of the part [s].
        record: Input of its likelihood.
        optimum: Its maximum.
        theta: g, log b, tau, shape (3,).
        covariance: Covariance of theta, shape (3, 3).
    """

    start: float
    end: float
    record: Record
    optimum: Optimum
    theta: Array
    covariance: Array


@dataclass(frozen=True)
class Constancy:
    """Test whether both halves of each flight have the same coefficients.

    Attributes:
        halves: The fitted halves of each flight of which both were, by its place.
        chi_square: Sum of the squared deviations from the weighted mean of their flight, or what common coefficients
            lose in likelihood, whichever is less likely to reject.
        degrees: Degrees of freedom.
        probability: Probability of a larger sum if the coefficients are the same.
    """

    halves: Mapping[int, tuple[Part, Part]]
    chi_square: float
    degrees: int
    probability: float


def changed_coefficients(fit: Fit, axis: str) -> Iterator[Finding]:
    """The finding that the coefficients of an axis change within the flights, if they do.

    Args:
        fit: A fit by the likelihood; the paper's method has no parts.
        axis: Name of the axis.
    """
    estimate = fit.estimates.get(axis)
    if estimate is None or fit.model.axes[axis].predictor is None:
        return
    serving = [f for f, s in zip(fit.flights, fit.model.flights, strict=True) if axis in s.axes]
    test, fitted = fit.braking.get(axis, (None, np.inf))
    if test and fitted < sum(f.duration for f in fit.flights):  # its law holds only while it is commanded
        serving = [part for f in serving if (part := commanded_parts(f, (axis,), test.late)).segments]
    found = constancy(serving, estimate, axis)
    if found is None or found.probability > LEVEL:
        return
    changed = [place for place, halves in found.halves.items() if _change(*halves) >= LEAST_CHANGE]
    if not changed:
        return
    worst = max(changed, key=lambda place: _apart(*found.halves[place]))
    log = serving[worst].path
    told = "; ".join(_told(part) for part in found.halves[worst])
    if len(serving) > 1:
        told = f"most in {log.rsplit('/', 1)[-1]}: {told}"
    yield Finding(
        "coefficients_change",
        "warning",
        f"input gain, damping and delay of {axis} differ between halves of the flights ({told}): chi-square "
        f"{found.chi_square:.0f} with {found.degrees} degrees of freedom, by chance in {found.probability:.0e}",
        f"the coefficients of {axis} are a mean over what changes; their intervals are of that mean",
        f"`rotorfit track {log}`, with the card of this fit, finds when it changed, and what; then fit each part by "
        "--span; if it raises no alarm, look for what varies: battery, speed range, a clock, the latency of the link",
        axis,
    )


def _change(first: Part, second: Part) -> float:
    """Relative change of input gain or damping between the halves of a flight, or ten times that of the delay [s]."""
    gain, log_damping, delay = np.abs(second.theta - first.theta)
    middle = abs(first.theta[0] + second.theta[0]) / 2
    return float(max(gain / middle, 2 * np.tanh(log_damping / 2), 10 * delay))


def _told(part: Part) -> str:
    gain, log_damping, delay = part.theta
    return f"{part.start:.0f} to {part.end:.0f} s: {gain:.3g}, {np.exp(log_damping):.3g} 1/s, {delay:.3f} s"


def constancy(flights: Sequence[Flight], estimate: Estimate, axis: str) -> Constancy | None:
    """Tests whether both halves of each flight have the same coefficients.

    Each half is fitted separately, starting from the whole fit, with its own trim and start velocities and at the
    disturbance levels of the whole fit, so that all halves are weighted alike.

    Args:
        flights: Those that move the axis.
        estimate: Estimate of the axis, alone or of x with y.
        axis: Name of the axis.

    Returns:
        The test; None if of no flight both halves are long enough and determine their coefficients.

    Source: the chi-square test of homogeneity of independent estimates; W. G. Cochran, Biometrics 10 (1954), p. 101.
    """
    from scipy.special import chdtrc

    fitted = [[_fitted(half, estimate, axis) for half in _halves(flight)] for flight in flights]
    both = {place: (one[0], one[1]) for place, one in enumerate(fitted) if len(one) == 2 and one[0] and one[1]}
    if not both:
        return None
    square, degrees = sum(_apart(*halves) for halves in both.values()), 3 * len(both)
    found = Constancy(both, square, degrees, float(chdtrc(degrees, square)))
    if found.probability > LEVEL:
        return found
    lost, free = zip(*(_lost_together(halves, estimate) for halves in both.values()), strict=True)
    together = Constancy(both, sum(lost), sum(free), float(chdtrc(sum(free), sum(lost))))
    return max(found, together, key=lambda one: one.probability)


def _apart(*halves: Part) -> float:
    """Sum of the squared deviations of two halves from their weighted mean, in standard errors."""
    weights = [np.linalg.inv(part.covariance) for part in halves]
    mean = np.linalg.solve(sum(weights), sum(w @ p.theta for w, p in zip(weights, halves, strict=True)))
    return sum(float((p.theta - mean) @ w @ (p.theta - mean)) for w, p in zip(weights, halves, strict=True))


def _lost_together(parts: Sequence[Part], estimate: Estimate) -> tuple[float, int]:
    """Twice the fall of the log-likelihood where all parts share their coefficients; and its degrees of freedom.

    Covariances tell how far a part is from the others only near its maximum. Under slow commands delay, damping and
    gain trade along a curve, and a part may be nearly as likely at the other end of it.

    Source: S. S. Wilks, Ann. Math. Statist. 9 (1938), pp. 60-62.
    """
    records, whole, K = [part.record for part in parts], estimate.optimum, estimate.optimum.point.gain.size
    point = _beginning(records, whole.point)
    free = np.arange(point.flat().size) < point.n
    free[: point.coefficients] = whole.free[: point.coefficients]
    together = maximise(records, point, free, prior=prior_of_law(whole.prior, K))
    apart = sum(part.optimum.score.log_likelihood for part in parts)
    return 2 * (apart - together.score.log_likelihood), int(free[: point.coefficients].sum()) * (len(parts) - 1)


def _halves(flight: Flight) -> list[Flight]:
    start, end = flight.segments[0].start, flight.segments[-1].end
    middle = (start + end) / 2
    spans = ((start, middle), (middle, end))
    return [between(flight, *span) for span in spans] if middle - start >= SHORTEST else []


def _fitted(flight: Flight, estimate: Estimate, axis: str) -> Part | None:
    """The coefficients of a part; None if it is too short or does not determine them."""
    axes, k, whole = estimate.records[0].axes, estimate.place, estimate.optimum.point
    rec, K = record(flight, axes), len(axes)
    if rec is None or not np.any(np.diff(rec.command[:, axes.index(axis)])):
        return None
    point = _beginning([rec], whole)
    free = np.arange(point.flat().size) < point.n
    free[: whole.coefficients] = estimate.optimum.free[: whole.coefficients]
    optimum = maximise([rec], point, free, prior=prior_of_law(estimate.optimum.prior, K))
    at = [k, K + k, 2 * K + k]
    theta = optimum.point.flat()[at]
    variance = optimum.covariance[np.ix_(at, at)]
    told = np.log(DAMPINGS[0]) < theta[1] < np.log(DAMPINGS[1]) and np.all(np.diag(variance) > 0)
    known = np.sqrt(variance[0, 0]) < 0.5 * abs(theta[0]) and np.sqrt(variance[1, 1]) < 1.0
    return Part(*flight.span, rec, optimum, theta, variance) if told and known else None


def _beginning(records: Sequence[Record], whole: Point) -> Point:
    """The coefficients and levels of the whole fit, no trims, and the velocities that the records start with."""
    return replace(
        start_point(records, 0.0, 1.0, whole.levels),
        gain=whole.gain,
        log_damping=whole.log_damping,
        delay=whole.delay,
        structures=whole.structures,
        extra=whole.extra,
    )


EVENT = 1.0
"""Changes of a command within this time are one event [s]: the horizon by which models are judged, and the reach of the
tests of residuals. A tap, on and off, is one event; a step held for longer, on and off, is two."""

ONE = 1.5
"""Number of events below which there is only one: nothing shows how it differs from the next."""

TWICE = 2.0
"""Ratio of the width of Student's interval over the events to the normal one above which the events are few."""


def command_events(flights: Sequence[Flight], axis: str) -> float:
    """Effective number of events of equal size in the commands of an axis.

    Windows of `EVENT` begin at the first change after the previous window; the size of an event is the range of the
    command in it, w its square, and the number is (sum w)^2 / sum w^2. Small corrections beside one large event count
    for little.

    Source: effective number of weighted observations: L. Kish, Survey Sampling (1965), section 11.7.

    Args:
        flights: Those that command the axis.
        axis: Name of the axis.
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
    """How many times wider than the normal interval one over so many events is, if what the model leaves out differs
    from event to event; infinite for one event.
    """
    return student_quantile(events - 1) / NORMAL if events >= ONE else float("inf")
