"""Starts of a law with a lag: the best nodes of a grid over delay, damping and lag, climbed on thinned records.

A climb that starts only from the maximum of the first-order law finds the nearest optimum, not the best one: a loop
that overshoots and a long lag are both mistaken for more delay. At fixed delay, damping and lag the motion is linear in
all other parameters (in the gain and in the product of gain and zero), so one pass gives the objective at their best
values; records at a third of the rate are sufficient for that.

Source: G. H. Golub, V. Pereyra, SIAM J. Numer. Anal. 10 (1973), pp. 413-432 (linear parameters projected out).
"""

import itertools
from collections.abc import Iterable, Sequence
from dataclasses import replace

import numpy as np

from rotorfit.core.frames import Array, Indices, Mask
from rotorfit.core.laws import FIRST_ORDER_DELAY, LAG, ZERO, Structure
from rotorfit.dynamics.disturbance import distinct_steps
from rotorfit.estimation.likelihood.axis_estimate import free_of
from rotorfit.estimation.likelihood.blocks import Record
from rotorfit.estimation.likelihood.fisher_scoring import maximise
from rotorfit.estimation.likelihood.likelihood import LikelihoodScore, inverted, linear_scores
from rotorfit.estimation.likelihood.parameters import Point
from rotorfit.estimation.likelihood.prior import GaussianPrior, with_prior
from rotorfit.estimation.likelihood.stretches import stretches

DELAYS = (0.0, 0.08, 0.18, 0.3, 0.45)

DAMPINGS = (0.3, 1.2, 4.0, 12.0)

LAGS = (0.03, 0.1, 0.25, 0.6)
"""Nodes of the grid: `DELAYS` [s], `DAMPINGS` [1/s] and `LAGS` [s]."""

EVERY = 3
"""Every third block of a record is used, which is still ten a second."""

COMMAND_TIME = 0.08
"""Commands at shorter intervals are averaged over this time [s]."""

CLIMBED = 4
"""Number of nodes that are climbed: the best ones, without those near a better one."""

APART = (0.06, 0.6, 0.8)
"""Largest differences of nodes that count as near each other: delay [s], logarithms of damping and lag."""

KEPT = 2
"""Number of climbed points that become starts, without..."""

REJECTED = 10.0
"""... those whose objective on the thinned records is below the best by this or more."""

TOGETHER = 16
"""Nodes whose motion is filtered in one pass."""

SHORT = 12
"""Largest number of passes of such a climb."""


def law_starts(
    records: Sequence[Record], point: Point, k: int, structure: Structure, prior: GaussianPrior | None = None
) -> list[Point]:
    """Start points of a law with a lag on axis k, the best first.

    Args:
        records: The flights.
        point: Any point of the axes; of its coefficients of axis k only the sign of the gain matters, and where no node
            of the grid has it, not even that.
        k: Index of the axis.
        structure: Linear law with a lag.
        prior: Prior of the parameters of the laws.
    """
    coarse, start = [thinned_record(rec) for rec in records], point.start
    if (count := sum(rec.starts.size for rec in coarse)) > len(start):
        point = replace(point, start=np.zeros((count, point.gain.size)))  # linear parameters, found in one step
    levels_held = free_of(coarse, [True] * point.gain.size, _at(point, k, structure, (0.1, 1.0, 0.1)).structures)
    levels_held[-point.levels.size :] = False
    sign = np.sign(point.gain[k])
    nodes = sorted(
        projected(coarse, [_at(point, k, structure, node) for node in _grid(structure)], k, prior),
        key=lambda one: -one[0],
    )
    every = [there for _, there in nodes]
    alike = [there for there in every if np.sign(there.gain[k]) == sign]
    climbed: list[tuple[float, Point]] = []
    for node in _spread(alike or every, k, CLIMBED):
        top = maximise(coarse, node, levels_held, tolerance=0.3, most=SHORT, prior=prior)
        climbed.append((top.score.objective, replace(swapped(top.point, k) or top.point, start=start)))
    climbed.sort(key=lambda one: -one[0])
    return _spread([there for value, there in climbed if value > climbed[0][0] - REJECTED], k, KEPT)


def swapped(point: Point, k: int) -> Point | None:
    """The point with lag and damping of axis k exchanged, for the same motion; None where the lag is the faster pole.

    A lag on the input and the damping are two poles in series, which are interchangeable. The faster one is the lag.
    """
    structure = point.structures[k] if point.structures else FIRST_ORDER_DELAY
    if structure.order != 1:
        return None
    e = next(e for e, one in enumerate(structure.extras) if one.place == LAG)
    if point.extra[e, k] + point.log_damping[k] <= 0:
        return None
    gain, log_damping, extra = point.gain.copy(), point.log_damping.copy(), point.extra.copy()
    log_damping[k], extra[e, k] = -extra[e, k], -log_damping[k]
    gain[k] *= np.exp(log_damping[k] + extra[e, k])
    other = replace(point, gain=gain, log_damping=log_damping, extra=extra)
    return other.with_flat(np.clip(other.flat(), *other.bounds()))


def _grid(structure: Structure) -> Iterable[tuple[float, ...]]:
    nodes = itertools.product(DELAYS if structure.delayed else (0.0,), DAMPINGS, LAGS)
    return (node for node in nodes if structure.order != 1 or node[1] * node[2] <= 1)


def _at(point: Point, k: int, structure: Structure, node: Sequence[float]) -> Point:
    """The point with axis k at a node of the grid: delay, damping and lag; without a zero."""
    delay, damping, lag = node
    K = point.gain.size
    gain, log_damping, delays = point.gain.copy(), point.log_damping.copy(), point.delay.copy()
    log_damping[k], delays[k] = np.log(damping), delay
    gain[k] *= damping / np.exp(point.log_damping[k])
    extra = np.zeros((max(len(point.extra), len(structure.extras)), K))
    extra[: len(point.extra)] = point.extra if point.extra.size else 0.0
    for e, one in enumerate(structure.extras):
        extra[e, k] = one.coordinate(lag if one.place == LAG else 0.0)
    laws = list(point.structures or (FIRST_ORDER_DELAY,) * K)
    laws[k] = structure
    return replace(point, gain=gain, log_damping=log_damping, delay=delays, extra=extra, structures=tuple(laws))


def projected(
    records: Sequence[Record], points: Sequence[Point], k: int, prior: GaussianPrior | None
) -> list[tuple[float, Point]]:
    """Largest objective over gain, zero, trims and start velocities, and where it is attained.

    Args:
        records: The flights.
        points: The points, equal in shape and levels.
        k: Index of the axis.
        prior: Prior of the parameters of the laws.
    """
    out = []
    for first in range(0, len(points), TOGETHER):
        some = points[first : first + TOGETHER]
        for point, there in zip(some, linear_scores(records, some, k), strict=True):
            out.append(_at_best(point, with_prior(there, point, prior), k))
    return out


def _at_best(point: Point, here: LikelihoodScore, k: int) -> tuple[float, Point]:
    """The objective and the point at its best linear parameters; at the zero of the point where that leaves its range.

    What is linear in place of the zero is its product with the gain.
    """
    linear = np.zeros(point.flat().size, bool)
    linear[k] = True
    linear[point.coefficients : point.n] = True
    for e, one in enumerate(point.extras(k)):
        if one.place != ZERO:
            continue
        free = linear.copy()
        free[(3 + e) * point.gain.size + k] = True
        value, there = _solved(point, here, free)
        extra, share = there.extra.copy(), point.gain[k] / there.gain[k]
        extra[e, k] = point.extra[e, k] + share * (extra[e, k] - point.extra[e, k])
        if one.low <= extra[e, k] <= one.high:
            return value, replace(there, extra=extra)
    return _solved(point, here, linear)


def _solved(point: Point, here: LikelihoodScore, linear: Mask) -> tuple[float, Point]:
    step = inverted(here.information, linear) @ here.gradient
    return here.objective + 0.5 * float(step @ here.gradient), point.with_flat(point.flat() + step)


def _spread(points: Iterable[Point], k: int, most: int) -> list[Point]:
    """The first `most` points, without those that are near an earlier one on axis k."""
    kept: list[Point] = []
    for point in points:
        here = _coordinates(point, k)
        if all((np.abs(here - _coordinates(other, k)) > APART).any() for other in kept):
            kept.append(point)
        if len(kept) == most:
            break
    return kept


def _coordinates(point: Point, k: int) -> Array:
    lag = next(e for e, one in enumerate(point.structures[k].extras) if one.place == LAG)
    return np.array([point.delay[k], point.log_damping[k], point.extra[lag, k]])


def thinned_record(rec: Record) -> Record:
    """The record with every third block, as a single pose, and with dense commands averaged; stretches of a long one.

    A record with velocities is returned as it is.
    """
    if rec.rate is not None:
        return rec
    segment = rec.segment
    place = np.arange(rec.count.size) - np.flatnonzero(rec.fresh)[segment]
    keep = np.flatnonzero(place % EVERY == 0)
    sizes = np.bincount(segment[keep])
    ends = np.cumsum(sizes)
    time = rec.block_time[keep]
    steps, step = distinct_steps(time)
    command_time, command, command_range = _thinned_commands(rec)
    thinned = replace(
        rec,
        pose_range=np.column_stack([ends - sizes, ends]),
        command_range=command_range,
        pose_time=time,
        yaw=rec.block_yaw[keep],
        block=np.arange(keep.size),
        count=rec.count[keep],
        block_time=time,
        steps=steps,
        step=step,
        block_yaw=rec.block_yaw[keep],
        position=rec.position[keep],
        fresh=rec.fresh[keep],
        command_time=command_time,
        command=command,
        size=np.ones(keep.size),
    )
    return stretches(thinned)


def _thinned_commands(rec: Record) -> tuple[Array, Array, Indices]:
    """Stamps, commands and the range of each segment; commands within `COMMAND_TIME` are replaced by their mean."""
    times, values, ranges, n = [], [], [], 0
    for first, last in rec.command_range:
        time, value = rec.command_time[first:last], rec.command[first:last]
        _, begin = np.unique(np.floor((time - time[0]) / COMMAND_TIME), return_index=True)
        held = np.diff(time, append=time[-1:] + COMMAND_TIME)[:, None]
        values.append(np.add.reduceat(value * held, begin) / np.add.reduceat(held, begin))
        times.append(time[begin])
        ranges.append((n, n + begin.size))
        n += begin.size
    return np.concatenate(times), np.ascontiguousarray(np.concatenate(values)), np.array(ranges, np.int64)
