"""Whether the coefficients stay what they are within a flight: fitted to its parts, are they the same?"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np

from rotorfit.estimate import Estimate
from rotorfit.finding import Finding
from rotorfit.fit import Fit
from rotorfit.flight import Flight
from rotorfit.frames import Array
from rotorfit.likelihood import inverted
from rotorfit.maximum import maximise
from rotorfit.modes import between, start_point
from rotorfit.record import record

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
        f"the coefficients of {axis} are a mean over what changes; their intervals are too narrow for any one time",
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
    from scipy.stats import chi2

    halves = [half for flight in flights for half in _halves(flight)]
    parts = [part for half in halves if (part := _fitted(half, estimate, axis))]
    if len(parts) < 2:
        return None
    weights = [np.linalg.inv(part.covariance) for part in parts]
    mean = np.linalg.solve(sum(weights), sum(w @ p.theta for w, p in zip(weights, parts, strict=True)))
    square = sum(float((p.theta - mean) @ w @ (p.theta - mean)) for w, p in zip(weights, parts, strict=True))
    degrees = 3 * (len(parts) - 1)
    return Constancy(tuple(parts), square, degrees, float(chi2.sf(square, degrees)))


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
