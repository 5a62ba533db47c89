"""Estimate from several flights -> an estimate from each flight alone, with its own disturbance levels."""

from dataclasses import replace

import numpy as np

from rotorfit.estimation.likelihood.axis_estimate import Estimate
from rotorfit.estimation.likelihood.fisher_scoring import maximise
from rotorfit.estimation.likelihood.likelihood import segments
from rotorfit.estimation.likelihood.prior import prior_of_law

TOLERANCE = 0.02
"""Expected gain in log-likelihood below which the climb of one flight ends: a fifth of a standard error."""

MOST_PASSES = 30
"""Largest number of passes over one flight."""


def each_flight(estimate: Estimate) -> list[Estimate | None]:
    """Estimates from every flight alone, each climbed from the estimate from all flights together.

    Coefficients of an axis whose command does not change in a flight are held at those of all flights. The
    prior of the lag belongs to the law and remains; that of the card would count once per flight and is left out.

    Returns:
        One estimate per flight; None where the flight does not change the command of the axis or the climb has not
        converged, so that one more step would gain 1 or more in log-likelihood.
    """
    return [_alone(estimate, j) for j in range(len(estimate.records))]


def _alone(estimate: Estimate, j: int) -> Estimate | None:
    whole, rec = estimate.optimum, estimate.records[j]
    point = replace(
        whole.point, trim=whole.point.trim[j : j + 1], start=whole.point.start[segments(estimate.records)[j]]
    )
    moves = np.array([bool(np.any(np.diff(rec.command[:, k]))) for k in range(len(rec.axes))])
    if not moves[estimate.place]:
        return None
    first = whole.point.coefficients
    free = np.ones(point.flat().size, bool)
    free[:first] = whole.free[:first] & np.tile(moves, first // len(moves))
    prior = prior_of_law(whole.prior, len(moves))
    optimum = maximise([rec], point, free, tolerance=TOLERANCE, most=MOST_PASSES, prior=prior)
    return replace(estimate, records=[rec], optimum=optimum) if optimum.gain < 1.0 else None
