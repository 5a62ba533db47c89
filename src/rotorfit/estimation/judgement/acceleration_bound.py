"""Test of the law against one with a bounded acceleration: a limit of tilt, of thrust, or of the set point's change.

The innovations of a vehicle with a bound A contain the response to what the bound takes off, one times, less what the
fit has absorbed of it. Regressed on that response, they give the factor s: 0 if there is no bound, about 1 at the
vehicle's. What the fit has absorbed is known, too: the estimates are off by -s times their weights' sum over the
response. As A is unknown, several are tried, each of which takes off another share of the acceleration.

General tests of the law hardly see a bound, because lag and damping take its place, and their intervals exclude the
truth: the bound acts seldom.

Source: Z. Griliches, Journal of Farm Economics 39 (1957), pp. 8-20 (the bias by what a regression leaves out); T. S.
Breusch, A. R. Pagan, Review of Economic Studies 47 (1980), pp. 239-253 (tests of a term that is left out); W. K. Newey,
K. D. West, Econometrica 55 (1987), pp. 703-708 (the variance of s).
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from rotorfit.core.frames import Array
from rotorfit.core.laws import FIRST_ORDER_DELAY, TRIM
from rotorfit.dynamics.bounded_motion import bounded_motion
from rotorfit.estimation.judgement.residual_variance import Weighted, orthonormal
from rotorfit.estimation.likelihood.axis_estimate import Estimate
from rotorfit.estimation.likelihood.block_response import response
from rotorfit.estimation.likelihood.blocks import Record
from rotorfit.estimation.likelihood.likelihood import segments, whiten
from rotorfit.estimation.likelihood.parameters import Point
from rotorfit.estimation.regression.paper import newey_west

SHARES = 0.005, 0.01, 0.02, 0.04, 0.08
"""Shares of the acceleration asked for that the bounds take off: less does no harm, more is seen by other tests."""

STEP = 0.01
"""Step of the grid [s]."""

MEMORY = 1.0
"""Time over which contributions to the score are correlated [s]."""


@dataclass(frozen=True)
class Bound:
    """The bound that the innovations contradict least.

    Attributes:
        acceleration: A [m/s^2 or rad/s^2].
        statistic: Square of its factor s over the variance; 0 where the innovations have the opposite sign.
        p_value: Probability of a larger factor of this sign at any of the bounds if there is none.
        sd: Quantity to the standard deviation that the bound adds to its estimate, in its standard errors.
    """

    acceleration: float
    statistic: float
    p_value: float
    sd: Mapping[str, float]


def bound_of(estimate: Estimate, weighted: Sequence[Weighted], errors: Mapping[str, float]) -> Bound | None:
    """The bound on the acceleration of an axis that its innovations speak for most.

    Args:
        estimate: Estimate by the likelihood.
        weighted: Its innovations and weights, in the order of `errors`.
        errors: Standard errors of its quantities on their scales, by name.

    Returns:
        None under laws other than those of the first order.
    """
    from scipy.special import ndtr

    structures = estimate.optimum.point.structures or (FIRST_ORDER_DELAY,)
    if any(not one.linear or one.kicks or one.order > 1 for one in structures):
        return None
    bounds, responses = _responses(estimate)
    bias = sum(np.einsum("bka,bkq->aq", rows, one.weight) for one, rows in zip(weighted, responses, strict=True))
    left = [_left(one, rows) for one, rows in zip(weighted, responses, strict=True)]
    power = np.maximum(sum(np.sum(rows**2, axis=(0, 1)) for rows in left), np.finfo(float).tiny)
    pairs = list(zip(weighted, left, strict=True))
    factor = sum(np.einsum("bka,bk->a", rows, one.innovation) for one, rows in pairs) / power
    variance = sum(_variance(one, rows, factor) for one, rows in pairs)
    error = np.sqrt(np.maximum(variance, power)) / power
    z = factor / error
    a = int(np.argmax(z))
    taken = float(np.sqrt(max(factor[a] ** 2 - error[a] ** 2, 0.0)))
    return Bound(
        float(bounds[a]),
        max(float(z[a]), 0.0) ** 2,
        min(1.0, bounds.size * float(ndtr(-z[a]))),
        {name: taken * abs(float(bias[a, q])) / errors[name] for q, name in enumerate(errors)},
    )


def _left(one: Weighted, rows: Array) -> Array:
    """What the fit has not absorbed of the responses (B, K, A) of one flight."""
    flat, basis = rows.reshape(-1, rows.shape[-1]), orthonormal(one.span.reshape(-1, one.span.shape[-1]))
    return np.asarray(flat - basis @ (basis.T @ flat)).reshape(rows.shape)


def _variance(one: Weighted, rows: Array, factor: Array) -> Array:
    """Variance of the score of each bound (A,), from what its factor leaves of the innovations of one flight."""
    score = np.einsum("bka,bka->ba", rows, one.innovation[:, :, None] - factor * rows)
    return newey_west(one.time, score - score.mean(axis=0), MEMORY).diagonal()


def _responses(estimate: Estimate) -> tuple[Array, list[Array]]:
    """Bounds (A,), and the whitened response of each flight to what they take off its axis, (B, K, A)."""
    point, K = estimate.optimum.point, estimate.optimum.point.gain.size
    grids = [_grids(rec, point, j, at) for j, (rec, at) in enumerate(_flights(estimate))]
    asked = [part.bounded(np.array([np.inf]))[0][0] for parts in grids for part in parts]
    bounds = _bounds(np.concatenate(asked))
    unit = replace(point, gain=np.ones(K), delay=np.zeros(K), structures=(), extra=np.zeros((0, K)))
    out = []
    for j, ((rec, at), parts) in enumerate(zip(_flights(estimate), grids, strict=True)):
        times = [part.time for part in parts]
        taken = np.concatenate([part.bounded(bounds)[1] for part in parts], axis=1)
        ends = np.cumsum([0, *(time.size for time in times)])
        driven = replace(rec, command_time=np.concatenate(times), command_range=np.stack([ends[:-1], ends[1:]], axis=1))
        columns = [
            response(replace(driven, command=one), unit, j, point.start[at])[1][:, estimate.place] for one in taken
        ]
        out.append(whiten(rec, np.stack(columns, axis=1), point.levels)[0].transpose(0, 2, 1))
    return bounds, out


def _flights(estimate: Estimate) -> list[tuple[Record, slice]]:
    return list(zip(estimate.records, segments(estimate.records), strict=True))


@dataclass(frozen=True)
class _Grid:
    """What drives the motion on a grid of times of one segment; see `bounded_motion`."""

    time: Array
    command: Array
    yaw: Array
    law: Array
    velocity: Array

    def bounded(self, bounds: Array) -> tuple[Array, Array]:
        """Accelerations asked for, and what the bounds take off them."""
        return bounded_motion(STEP, self.command, self.yaw, self.law, self.velocity, bounds)


def _grids(rec: Record, point: Point, flight: int, at: slice) -> list[_Grid]:
    """The grid of each segment."""
    command_time, command, command_range = rec.switches
    law = point.laws
    law[:, TRIM] = point.trim[flight]
    out = []
    for s, (first, last) in enumerate(command_range):
        time = np.arange(rec.starts[s], rec.pose_time[rec.pose_range[s, 1] - 1], STEP)
        held = [
            np.maximum(np.searchsorted(command_time[first:last], time - delay, side="right") - 1, 0) + first
            for delay in point.delay
        ]
        forced = np.column_stack([command[held[k], k] for k in range(point.gain.size)])
        yaw = np.interp(time, rec.pose_time, rec.yaw)
        out.append(_Grid(time, forced, yaw, law, point.start[at][s].copy()))
    return out


def _bounds(asked: Array) -> Array:
    """Bounds that take each of the `SHARES` off accelerations asked for (N,)."""
    size = np.sort(asked)[::-1]
    above = np.cumsum(size) - size * np.arange(1, size.size + 1)
    return np.asarray(np.interp(np.array(SHARES) * size.sum(), above, size))
