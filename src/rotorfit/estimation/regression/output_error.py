"""The rung `oe`: output error, that is least squares on positions simulated over whole segments, for white residuals.

It is the likelihood without its disturbance model: its regressors contain no noise, so it is unbiased in an open loop;
but wind makes positions drift for minutes, and every sample of that drift is treated as independent evidence.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from rotorfit.core.flight_data import Flight
from rotorfit.core.frames import Array, Mask
from rotorfit.core.laws import DELAY_RANGE, START_LEVELS
from rotorfit.core.model import Predictor
from rotorfit.dynamics.disturbance import stationary, step_tables
from rotorfit.estimation.likelihood.block_response import response
from rotorfit.estimation.likelihood.blocks import Record, record
from rotorfit.estimation.likelihood.likelihood import segments
from rotorfit.estimation.likelihood.noise_levels import settle_levels
from rotorfit.estimation.likelihood.optima import start_point
from rotorfit.estimation.likelihood.parameters import DAMPING_RANGE, Point
from rotorfit.estimation.regression.delay import best_delay
from rotorfit.estimation.regression.equation import state_variable_filter
from rotorfit.estimation.regression.least_squares import CUT_OFF
from rotorfit.estimation.regression.problem import coefficients, problem_of, unfit
from rotorfit.estimation.regression.result import MethodResult, without_numbers
from rotorfit.estimation.regression.sandwich import SINGULAR

START_DELAYS = (0.05, 0.2, 0.4)
"""Start delays [s], in addition to that of the state-variable filter: the sum of squares has several minima."""

ROUNDS = 60
"""Number of steps after which a search that still descends counts as diverged."""

GAINED = 1e-8
"""Relative decrease of the sum of squares at which the search has converged."""

FIRST_DAMPING, LEAST_DAMPING, MOST_DAMPING = 1e-3, 1e-9, 1e9
"""Levenberg's damping relative to the diagonal: start value, lower and upper limit."""


@dataclass(frozen=True)
class Squares:
    """The sum of squared position errors at a point, over the n coefficients, trims and start velocities.

    Attributes:
        total: Sum over all flights [unit^2]; a block is weighted by its number of poses.
        gradient: J'(measured - simulated): minus half the gradient of `total`, shape (n,).
        information: J'J, shape (n, n).
        slopes: Contribution of a unit error in each block to `gradient`, shape (B, n, K) for each flight.
    """

    total: float
    gradient: Array
    information: Array
    slopes: tuple[Array, ...]


def oe(flights: Sequence[Flight], axes: tuple[str, ...]) -> MethodResult:
    """Output error with delay, trim and start velocity, by damped Gauss-Newton steps with exact sensitivities.

    Args:
        flights: One or more flights of one vehicle and setting.
        axes: `("z",)`, `("yaw",)` or `("x", "y")`.

    Source: L. Ljung, System Identification, 2nd ed. 1999, sections 7.5, 9.2 and 10.2. The covariance is the sandwich
    I^-1 J'SJ I^-1, S being that of the disturbance, since the residuals are anything but white.
    """
    problem = problem_of(flights, axes, state_variable_filter((CUT_OFF,) * 3))
    failed = unfit(problem)
    if failed:
        return without_numbers("oe", axes, len(flights), failed)
    places = [j for j, flight in enumerate(flights) if record(flight, axes)]
    records = [rec for flight in flights if (rec := record(flight, axes))]
    active = np.isin(np.arange(len(axes)), problem.layout.active)
    guess = best_delay(problem)
    begun = start_point(records, START_DELAYS[1], 1.0, np.tile(START_LEVELS, (len(axes), 1)))
    starts = [_at(begun, active, delay) for delay in START_DELAYS]
    if guess is not None:
        by_filter = coefficients(problem, guess, problem.parts[0].flight)
        low, high = DAMPING_RANGE
        near = replace(begun, gain=by_filter.gain, log_damping=np.log(np.clip(by_filter.damping, 10 * low, high / 10)))
        starts.append(_at(near, active, by_filter.delay))
    free = _free(begun, active)
    ends = [end for start in starts if (end := _descended(records, start, free))]
    if not ends:
        reason = ("diverged", f"the sum of squares still fell after {ROUNDS} steps")
        return without_numbers("oe", axes, len(flights), dict.fromkeys(axes, reason))
    point, squares = min(ends, key=lambda end: end[1].total)
    return _rung(flights, records, point, squares, free, axes, active, places)


def _at(point: Point, active: Mask, delay: float | Array) -> Point:
    """The point with a given delay [s]; axes that are not active get no gain, no delay and a damping of 1 1/s."""
    return replace(
        point,
        gain=np.where(active, point.gain, 0.0),
        log_damping=np.where(active, point.log_damping, 0.0),
        delay=np.where(active, delay, 0.0),
    )


def _free(point: Point, active: Mask) -> Mask:
    """Which of the n parameters are free; the damping of an idle axis is, since turning couples it to the other one."""
    turning = active | np.full(active.size, active.any())
    return np.concatenate([active, turning, active, np.ones(point.n - 3 * active.size, bool)])


def squares_of(records: Sequence[Record], point: Point) -> Squares:
    """The sum of squares at a point, minimised over the position at the start of each segment."""
    K, n, F = point.gain.size, point.n, len(records)
    total, gradient, information, slopes = 0.0, np.zeros(n), np.zeros((n, n)), []
    for j, (rec, at) in enumerate(zip(records, segments(records), strict=True)):
        mean, sensitivity = response(rec, point, j, point.start[at])
        B = rec.count.size
        segment = rec.segment
        J = np.zeros((B, n, K))
        J[:, : 3 * K] = sensitivity[:, : 3 * K]
        J[:, 3 * K + j * K : 3 * K + (j + 1) * K] = sensitivity[:, 3 * K : 4 * K]
        for s in range(at.start, at.stop):
            first, own = 3 * K + F * K + s * K, segment == s - at.start
            J[own, first : first + K] = sensitivity[own, 4 * K :]
        error = (rec.position - mean)[:, None, :]
        both = np.concatenate([error, J], axis=1)
        for s in range(at.stop - at.start):
            own = segment == s
            both[own] -= np.average(both[own], axis=0, weights=rec.count[own])
        error, J = both[:, 0], both[:, 1:]
        slope = rec.count[:, None, None] * J
        total += float(rec.count @ np.sum(error**2, axis=1))
        gradient += np.einsum("bnk,bk->n", slope, error)
        information += np.einsum("bnk,bmk->nm", slope, J, optimize=True)
        slopes.append(slope)
    return Squares(total, gradient, information, tuple(slopes))


def _descended(records: Sequence[Record], point: Point, free: Mask) -> tuple[Point, Squares] | None:
    """The local minimum from a start, inside the ranges of the search, by Levenberg's steps; None if not reached."""
    here, damping = squares_of(records, point), FIRST_DAMPING
    low, high = (end[: point.n] for end in point.bounds())
    for _ in range(ROUNDS):
        value = point.flat()[: point.n]
        stuck = ((value <= low) & (here.gradient < 0)) | ((value >= high) & (here.gradient > 0))
        movable = np.flatnonzero(free & ~stuck & (np.diag(here.information) > 0))
        block = here.information[np.ix_(movable, movable)]
        while True:
            step = np.zeros(point.flat().size)
            size = np.diag(block)
            step[movable] = np.linalg.solve(block + np.diag(damping * size), here.gradient[movable])
            trial = point.moved(step)
            there = squares_of(records, trial)
            if there.total < here.total or damping >= MOST_DAMPING:
                break
            damping *= 10
        gained = here.total - there.total if np.isfinite(there.total) else 0.0
        if gained <= GAINED * here.total:
            return (trial, there) if gained > 0 else (point, here)
        point, here, damping = trial, there, max(damping / 10, LEAST_DAMPING)
    return None


def _rung(
    flights: Sequence[Flight], records: Sequence[Record], point: Point, squares: Squares, free: Mask,
    axes: tuple[str, ...], active: Mask, places: Sequence[int],
) -> MethodResult:  # fmt: skip
    """The minimum with its sandwich covariance.

    An axis whose gain or damping ended at a bound has no numbers; a delay at a bound gets the variance of a uniform
    distribution over its range.
    """
    K = len(axes)
    low, high = (end[: point.n] for end in point.bounds())
    value, damping = point.flat()[: point.n], np.exp(point.log_damping)
    used = free & (value > low) & (value < high) & (np.diag(squares.information) > 0)
    known = {
        a: Predictor(*p)
        for a, *p in zip(axes, point.gain.tolist(), damping.tolist(), point.delay.tolist(), strict=True)
    }
    block = np.ix_(used, used)
    if np.linalg.cond(_scaled(squares.information[block])) > 1 / SINGULAR:
        reason = ("not_identifiable", "the sensitivities are dependent")
        return without_numbers("oe", axes, len(flights), dict.fromkeys(axes, reason))
    bread, full = np.linalg.inv(squares.information[block]), np.zeros((point.n, point.n))
    full[block] = bread @ _filling(flights, records, squares, known)[block] @ bread
    scale = np.concatenate([np.ones(K), damping, np.ones(K)])
    covariance = full[: 3 * K, : 3 * K] * np.outer(scale, scale)
    trim = np.zeros((len(flights), K))
    trim[list(places)] = point.trim
    nothing = np.where(active, 0.0, np.nan)
    idle = ("not_excited", "the command is zero in all usable data")
    failed = {axis: idle for axis, moves in zip(axes, active, strict=True) if not moves}
    for k, axis in enumerate(axes):
        if active[k] and not used[[k, K + k]].all():
            failed[axis] = ("diverged", f"the damping ended at {damping[k]:.3g} 1/s, the end of its range")
        if not used[2 * K + k]:  # a delay at the end of its range: variance of a uniform distribution over the range
            covariance[2 * K + k, 2 * K + k] = np.ptp(DELAY_RANGE) ** 2 / 12
    return MethodResult(
        method="oe",
        axes=axes,
        gain=point.gain + nothing,
        damping=damping + nothing,
        delay=point.delay + nothing,
        trim=trim,
        covariance=covariance,
        failed=failed,
    )


def _scaled(matrix: Array) -> Array:
    size = np.sqrt(np.diag(matrix))
    return np.asarray(matrix / np.outer(size, size))


def _filling(
    flights: Sequence[Flight], records: Sequence[Record], squares: Squares, known: Mapping[str, Predictor]
) -> Array:
    """Covariance of the gradient under the disturbance levels estimated at the minimum, shape (n, n).

    A kernel estimate cannot handle residuals that drift for minutes: over 60 s, in simulation, the intervals of Newey
    and West contained the truth in 45 to 85 % of the flights, these do in 88 to 100 %. Where the vehicle turns, the
    covariances under the levels of x and of y are averaged.
    """
    total = np.zeros_like(squares.information)
    for group, whitened, optimum in settle_levels(flights, known):
        for j, (rec, slope) in enumerate(zip(records, squares.slopes, strict=True)):
            for k in range(len(group)):
                if len(group) == slope.shape[2] == 2:
                    parts = [0.5**0.5 * slope[:, :, c] for c in (0, 1)]
                elif slope.shape[2] == 2:
                    c, s = np.cos(rec.heading), np.sin(rec.heading)
                    along = (c, s) if group[k] == "x" else (-s, c)
                    parts = [along[0] * slope[:, :, 0] + along[1] * slope[:, :, 1]]
                else:
                    parts = [slope[:, :, 0]]
                for part in parts:
                    total += sum_variance(whitened[j], part, np.exp(optimum.point.levels[k]))
    return total


def sum_variance(rec: Record, weights: Array, levels: Array) -> Array:
    """Covariance of sums over blocks of weight times (disturbance plus pose noise), shape (n, n).

    Args:
        rec: The blocks.
        weights: Shape (B, n); they sum to 0 over each segment, since its start position is free.
        levels: q, r, alpha, kappa, not as logarithms, shape (4,).
    """
    F, Q = step_tables(rec.steps, levels[2], levels[3])
    spread = np.array(stationary(levels))
    total = (weights * (levels[1] / rec.count)[:, None]).T @ weights
    ahead = np.zeros((weights.shape[1], 3))  # contribution of one unit of each state to the sums from here on
    for b in range(len(weights) - 1, -1, -1):
        ahead[:, 0] += weights[b]
        if rec.fresh[b]:
            total += (ahead[:, 1:] * spread) @ ahead[:, 1:].T
            ahead[:] = 0.0
        else:
            total += levels[0] * ahead @ Q[rec.step[b]] @ ahead.T
            ahead = ahead @ F[rec.step[b]]
    return np.asarray(total)
