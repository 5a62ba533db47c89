"""Estimate of several flights -> what each of them says alone, with its own wind."""

from dataclasses import replace

import numpy as np

from rotorfit.estimation.likelihood.axis_estimate import Estimate
from rotorfit.estimation.likelihood.fisher_scoring import maximise
from rotorfit.estimation.likelihood.likelihood import segments

TOLERANCE = 0.02
"""Expected gain in log-likelihood below which the climb of one flight ends: a fifth of a standard error."""

MOST_PASSES = 30
"""Passes after which a flight that is still climbing tells nothing."""


def each_flight(estimate: Estimate) -> list[Estimate | None]:
    """Every flight by itself, climbed from where all of them together ended; None for one that does not settle.

    An axis that a flight does not move keeps the coefficients of all.
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
    optimum = maximise([rec], point, free, tolerance=TOLERANCE, most=MOST_PASSES)
    return replace(estimate, records=[rec], optimum=optimum) if optimum.gain < 1.0 else None
