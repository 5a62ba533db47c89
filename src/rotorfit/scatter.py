"""Flight-to-flight scatter: what each flight says alone, and whether together they say one thing.

Source: W. G. Cochran, Biometrics 10 (1954), pp. 101-129 (Q); J. P. T. Higgins, S. G. Thompson, Statistics in Medicine
21 (2002), pp. 1539-1558 (I^2); R. T. Birge, Physical Review 40 (1932), pp. 207-227 (the factor, of one coefficient);
K.-Y. Liang, S. L. Zeger, Biometrika 73 (1986), pp. 13-22 (the same for several: a sandwich over flights).
"""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from rotorfit.accuracy import FlightEstimate, Scatter
from rotorfit.estimate import Estimate
from rotorfit.frames import Array
from rotorfit.likelihood import inverted, score, segments
from rotorfit.maximum import Optimum, maximise
from rotorfit.model import COEFFICIENTS
from rotorfit.record import Record

TOLERANCE = 1e-3
"""Expected gain in log-likelihood below which a climb ends."""


def scatter(estimate: Estimate, serving: Sequence[int]) -> Scatter | None:
    """How the flights of an axis agree; None for fewer than two.

    The levels of the disturbance are held at those of all flights together; trim and start velocity are every flight's
    own in any case. Of two axes in one likelihood the other one's coefficients are held.

    Args:
        estimate: The axis, from all flights.
        serving: Places of its flights among all flights, for the result.
    """
    from scipy.special import chdtrc

    if len(estimate.records) < 2 or not estimate.excited:
        return None
    k, K = estimate.place, estimate.optimum.point.gain.size
    own = [k, K + k, 2 * K + k]
    common = _settled(estimate.records, estimate.optimum, own)
    alone, height, filling = [], 0.0, np.zeros((3, 3))
    for rec, at, trim in zip(estimate.records, segments(estimate.records), common.point.trim, strict=True):
        part = replace(common, point=replace(common.point, trim=trim[None], start=common.point.start[at]))
        slope = score([rec], part.point).gradient[own]
        filling += np.outer(slope, slope)
        alone.append(_settled([rec], part, own))
        height += alone[-1].score.log_likelihood
    ratio = max(2 * (height - common.score.log_likelihood), 0.0)
    values = np.array([optimum.point.flat()[own] for optimum in alone])
    covariance = [inverted(o.score.information, o.free)[np.ix_(own, own)] for o in alone]
    variance = np.array([np.diag(one) for one in covariance])
    (q, mean), freedom = _cochran(values, variance), len(alone) - 1
    together = {} if estimate.optimum.point.structures else _combined(values, covariance)
    cochran = _named(q) | {name: float(_cochran(*parts)[0]) for name, parts in together.items()}
    bread = inverted(common.score.information, common.free)[np.ix_(own, own)]
    among = np.diag(bread @ filling @ bread) * len(alone) / freedom
    flights = [
        FlightEstimate(
            place,
            _named(_plain(values[i])) | {name: float(value[i]) for name, (value, _) in together.items()},
            _named(np.sqrt(variance[i]) * [1.0, np.exp(values[i][1]), 1.0])
            | {name: float(np.sqrt(spread[i])) for name, (_, spread) in together.items()},
        )
        for i, place in enumerate(serving)
    ]
    return Scatter(
        flights=tuple(flights),
        mean=_named(_plain(mean)),
        cochran=cochran,
        i_squared={name: max(1 - freedom / max(one, 1e-300), 0.0) for name, one in cochran.items()},
        factor=_named(np.sqrt(np.maximum(among / np.diag(bread), 1.0))),
        ratio=ratio,
        freedom=len(own) * freedom,
        p_value=float(chdtrc(len(own) * freedom, ratio)),
    )


def _cochran(values: Array, variance: Array) -> tuple[Array, Array]:
    """Cochran's Q, and the weighted mean, over the flights, which are the rows."""
    weight = 1 / np.maximum(variance, 1e-300)
    mean = np.sum(weight * values, axis=0) / np.sum(weight, axis=0)
    return np.sum(weight * (values - mean) ** 2, axis=0), mean


def _combined(values: Array, covariance: Sequence[Array]) -> dict[str, tuple[Array, Array]]:
    """Steady gain and total lag of each flight, and their variances: known where their parts are not."""
    gain, damping, delay = values[:, 0], np.exp(values[:, 1]), values[:, 2]
    zero, one = np.zeros(len(values)), np.ones(len(values))
    parts = {
        "steady_gain": (gain / damping, np.stack([1 / damping, -gain / damping, zero], axis=1)),
        "total_lag": (delay + 1 / damping, np.stack([zero, -1 / damping, one], axis=1)),
    }
    return {name: (told, np.einsum("fi,fij,fj->f", by, np.array(covariance), by)) for name, (told, by) in parts.items()}


def _settled(records: Sequence[Record], near: Optimum, own: Sequence[int]) -> Optimum:
    """The maximum over the coefficients of one axis, trims and start velocities, at the levels that are given."""
    point = near.point
    free = np.zeros(point.flat().size, bool)
    free[list(own)] = True
    free[point.n - point.trim.size - point.start.size : point.n] = True
    return maximise(records, point, free, tolerance=TOLERANCE)


def _plain(values: Array) -> Array:
    """Input, damping, delay from input, log damping, delay."""
    return np.array([values[0], np.exp(values[1]), values[2]])


def _named(values: Array) -> dict[str, float]:
    return {name: float(value) for name, value in zip(COEFFICIENTS, values, strict=True)}
