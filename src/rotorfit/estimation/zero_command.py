"""Test whether a vehicle obeys another law while its command is zero: many vehicles brake then, or hold their position.

The innovations of the fit are tested for a damping that acts only while the command is zero. Its effect on the position
is simulated: the velocity that results from the commands alone, with the sign reversed and only while the command is
zero, is an acceleration; the first-order law, behind the lag that the axis has, turns it into a position, which passes
through the likelihood's filter as the pose does. The effects of any linear law (every coefficient, trim, start, and
each command of the previous second with a weight of its own) are projected out first, so that an unmodelled lag is not
mistaken for braking.
"""

import itertools
from collections.abc import Iterator, Sequence
from dataclasses import replace

import numpy as np

from rotorfit.core.compiled import kernel
from rotorfit.core.finding import Finding
from rotorfit.core.flight_data import Flight, Segment
from rotorfit.core.frames import AXES, Array, Mask, heading_from_world
from rotorfit.core.laws import DELAY_RANGE
from rotorfit.core.model import NORMAL
from rotorfit.core.results import Braking
from rotorfit.dynamics.long_run import frequencies, two_sided, variance_of_mean
from rotorfit.estimation.judgement.residual_variance import orthonormal
from rotorfit.estimation.likelihood.axis_estimate import Estimate
from rotorfit.estimation.likelihood.block_response import response
from rotorfit.estimation.likelihood.blocks import Record
from rotorfit.estimation.likelihood.likelihood import segments, whiten
from rotorfit.estimation.likelihood.parameters import Point

ZERO = 0.02
"""Share of the largest command up to which a command counts as zero."""

SHORTEST = 0.2
"""Shortest time for which a command must stay zero to count as zero [s]: sines pass through zero."""

LEAST_SHARE = 0.03
"""Least share of the blocks with a zero command, and likewise with a non-zero one, for which the test is made."""

STEP = 0.01
"""Step of the simulation [s]."""

LAGS = tuple(0.1 * j for j in range(11))
"""Ages of the commands to which a linear law may give any weight [s]."""


def braking(estimate: Estimate) -> Braking | None:
    """Tests whether an axis has another damping while its command is zero.

    Args:
        estimate: Estimate of the axis, alone or x with y.

    Returns:
        The test; None where the axis is not excited, where its command is almost never or almost always zero, or where
        a linear law has the same effect.

    Source: the score test of an added parameter, C. R. Rao, Proc. Camb. Phil. Soc. 44 (1948), pp. 50-57; the variance
    of the score as in `long_run`.
    """
    k, optimum = estimate.place, estimate.optimum
    if not estimate.excited:
        return None
    zero = np.concatenate([_at_zero(rec, k, rec.block_time - optimum.point.delay[k]) for rec in estimate.records])
    share = float(np.mean(zero))
    if not LEAST_SHARE < share < 1 - LEAST_SHARE:
        return None
    parts = [
        _freed(rec, estimate, flight, rows)
        for flight, (rec, rows) in enumerate(zip(estimate.records, segments(estimate.records), strict=True))
    ]
    column, left = (np.concatenate([part[i] for part in parts]) for i in (0, 1))
    power = float(column @ column)
    if not power > 0:
        return None
    scores = column * left
    count = frequencies(scores.size)
    spread = float(np.sqrt(variance_of_mean(scores[:, None], count)[0, 0]))
    if not spread > 0:
        return None
    ratio = float(np.mean(scores)) / spread
    further = float(scores.sum()) / power
    damping = float(np.exp(optimum.point.log_damping[k]))
    error = abs(further / ratio) if ratio else np.inf
    return Braking(further, error, two_sided(ratio, count), share, damping, late_by(estimate))


def late_by(estimate: Estimate) -> float:
    """Delay of an axis and twice its lag [s]: after half of it the braking before a command has mostly ended."""
    point, k = estimate.optimum.point, estimate.place
    return float(point.delay[k]) + 2.0 * _lag(point, k)


def _lag(point: Point, k: int) -> float:
    """Lag of the law of axis k, less its zero [s]."""
    extra = point.extra_values(k)
    return max(extra.get("lag", 0.0) - extra.get("zero", 0.0), 0.0)


def _at_zero(rec: Record, k: int, time: Array) -> Mask:
    """Whether the command of axis k in force at each time [s] is zero, and part of a long enough run of zeros."""
    zero = _zero(rec.command_time, rec.command[:, [k]])
    return np.asarray(zero[np.maximum(np.searchsorted(rec.command_time, time, side="right") - 1, 0)])


def _zero(stamps: Array, command: Array) -> Mask:
    """Which commands, shape (M, K), are zero on all axes and stay so for `SHORTEST`, shape (M,)."""
    zero = np.all(np.abs(command) <= ZERO * np.max(np.abs(command), axis=0, initial=0.0), axis=1)
    edges = np.flatnonzero(np.diff(zero.astype(np.int8))) + 1
    for first, last in zip([0, *edges], [*edges, zero.size], strict=True):
        end = stamps[last] if last < zero.size else stamps[-1]
        if zero[first] and end - stamps[first] < SHORTEST:
            zero[first:last] = False
    return np.asarray(zero)


def _freed(rec: Record, estimate: Estimate, flight: int, rows: slice) -> tuple[Array, Array]:
    """Effect of unit braking on the innovations of one flight, and the innovations, a linear law's effects taken off.

    Both have shape (B,).
    """
    white, begin = _whitened(rec, estimate, flight, estimate.optimum.point.start[rows])
    starts = [white[:, begin] * (rec.segment == number)[:, None] for number in range(rec.starts.size)]
    free = orthonormal(np.hstack([np.delete(white[:, :-1], begin, axis=1), *starts]))
    own, e = white[:, -1], estimate.optimum.score.innovations[flight][:, estimate.place]
    return own - free @ (free.T @ own), e - free @ (free.T @ e)


def _whitened(rec: Record, estimate: Estimate, flight: int, start: Array) -> tuple[Array, slice]:
    """Whitened effects on axis k of its own parameters, then those of `_positions`; places of the start velocities."""
    point = estimate.optimum.point
    known = response(rec, point, flight, start)[1]
    columns = np.concatenate([known, _positions(rec, estimate, start)], axis=1)
    begin = slice(known.shape[1] - len(rec.axes), known.shape[1])
    del known  # half an hour takes 10 MB and more, and so do the next ones
    return whiten(rec, columns, point.levels)[0][:, :, estimate.place].copy(), begin


def _positions(rec: Record, estimate: Estimate, start: Array) -> Array:
    """Positions of the blocks under accelerations of axis k, world frame, shape (B, C, K).

    The C accelerations are the commands of each age in `LAGS`, then unit damping, then unit braking.
    """
    k, K, point = estimate.place, len(rec.axes), estimate.optimum.point
    groups = np.zeros((rec.weight.size, len(LAGS) + 2, K))
    lags = np.array([_lag(point, j) for j in range(K)])
    for number, (first, last) in enumerate(rec.pose_range):
        c0, c1 = rec.command_range[number]
        stamps, command = rec.command_time[c0:c1], rec.command[c0:c1]
        time = np.arange(rec.starts[number], rec.pose_time[last - 1] + 2 * STEP, STEP)
        yaw = np.interp(time, rec.pose_time[first:last], rec.yaw[first:last]) if K == 2 else np.zeros(time.size)
        delayed = [np.maximum(np.searchsorted(stamps, time - tau, side="right") - 1, 0) for tau in point.delay]
        pull = np.stack([point.gain[j] * command[delayed[j], j] for j in range(K)], axis=1)
        velocity = _moved(_lagged(pull, lags), np.exp(point.log_damping), yaw, start[number])[1]
        along = heading_from_world(velocity, yaw)[:, k] if K == 2 else velocity[:, 0]
        braked = _lagged((-along * _at_zero(rec, k, time - point.delay[k]))[:, None], lags[[k]])[:, 0]
        at = (rec.pose_time[first:last] - time[0]) / STEP
        before = np.minimum(at.astype(np.int64), time.size - 2)
        part = (at - before)[:, None]
        held = (command[np.maximum(np.searchsorted(stamps, time - age, side="right") - 1, 0), k] for age in LAGS)
        for column, each in enumerate(itertools.chain(held, (-along, braked))):  # together, half an hour takes 200 MB
            pull = np.zeros((time.size, K))
            pull[:, k] = each
            position = _moved(pull, np.exp(point.log_damping), yaw, np.zeros(K))[0]
            seen = position[before] * (1 - part) + position[before + 1] * part
            for j in range(K):
                groups[:, column, j] += np.bincount(rec.block[first:last], seen[:, j], rec.weight.size)
    groups *= rec.weight[:, None, None]
    return rec.observed(groups)


def _lagged(pull: Array, lags: Array) -> Array:
    """Accelerations (T, K) behind the lag of each axis [s]."""
    out, late = pull.copy(), lags > 0
    if late.any():
        level, none = np.zeros(len(pull)), np.zeros(late.sum())
        out[:, late] = _moved(pull[:, late] / lags[late], 1 / lags[late], level, none)[1]
    return out


def _moved(pull: Array, damping: Array, yaw: Array, start: Array) -> tuple[Array, Array]:
    """World positions and velocities (T, K) under accelerations in the heading frame (T, K) and linear damping.

    Second order in the step: the position by the trapezoidal rule, the velocity by a damping that is exact for constant
    yaw.
    """
    kept, gained = np.exp(-damping * STEP), -np.expm1(-damping * STEP) / damping
    velocity, position = np.empty_like(pull), np.zeros_like(pull)
    _driven(pull * gained, kept, np.column_stack([np.cos(yaw), np.sin(yaw)]), start.astype(float), velocity)
    position[1:] = np.cumsum(0.5 * STEP * (velocity[1:] + velocity[:-1]), axis=0)
    return position, velocity


@kernel()
def _driven(push: Array, kept: Array, turn: Array, start: Array, velocity: Array) -> None:
    """Fills the world velocities before each step (T, K), from the gain (T, K) and kept share (K,) of each step."""
    last = push.shape[1] - 1
    x, y = start[0], start[last]
    for i in range(push.shape[0]):
        velocity[i, 0], velocity[i, last] = x, y
        if last == 0:
            x = y = kept[0] * x + push[i, 0]
        else:
            c, s = turn[i, 0], turn[i, 1]
            forward, left = kept[0] * (c * x + s * y) + push[i, 0], kept[1] * (c * y - s * x) + push[i, 1]
            x, y = c * forward - s * left, s * forward + c * left


def commanded_parts(flight: Flight, axes: Sequence[str], late: float) -> Flight:
    """The flight with only those segments in which one of the given axes is commanded, so that one law holds.

    The likelihood uses poses only from the longest delay of the search after the start of a segment. So each segment
    begins early enough that the response to the first command is used, and with it at most half a delay of the braking
    before and what is left of it after one lag. It ends where the command returns to zero. Segments that are too short
    are dropped.

    Args:
        flight: Any flight.
        axes: Names of the axes.
        late: Approximate delay of these axes and twice their lag [s].
    """
    column = [AXES.index(axis) for axis in axes]
    time, zero = flight.command_time, _zero(flight.command_time, flight.command[:, column])
    parts: list[Segment] = []
    for whole in flight.segments:
        first, last = np.searchsorted(time, [whole.start, whole.end])
        edges = np.flatnonzero(np.diff(np.concatenate([[True], zero[first:last], [True]]).astype(np.int8))) + first
        for begin, end in zip(edges[::2].tolist(), edges[1::2].tolist(), strict=True):
            before = parts[-1].end if parts else whole.start
            start = max(float(time[begin]) - DELAY_RANGE[1] + max(0.5 * late, 0.0), before, whole.start)
            stop = float(time[end]) if end < last else whole.end
            if stop - start > DELAY_RANGE[1] + SHORTEST:
                parts.append(Segment(start, stop))
    return replace(flight, segments=tuple(parts))


def findings_of_braking(axis: str, found: Braking, time: float, whole: float) -> Iterator[Finding]:
    """The finding that an axis brakes while its command is zero.

    Args:
        axis: Name.
        found: The test on the whole flights.
        time: Total length of the parts that the axis was fitted to [s]; equal to `whole` where these were not enough.
        whole: Total length of the flights [s].
    """
    apart = time < whole
    yield Finding(
        "brakes_at_zero",
        "warning" if apart else "error",
        f"while the command of {axis} is zero, {100 * found.share:.0f} % of the time, a damping of {found.further:.2g} "
        f"+- {NORMAL * found.error:.1g} 1/s acts in addition to that of the law, according to one linearised step "
        f"(p = {found.probability:.1g}); no linear law does that",
        f"{axis} was fitted to the {time:.0f} of {whole:.0f} s in which it is commanded, and the model is valid "
        "for these only: at zero command the vehicle brakes by itself"
        if apart
        else f"the coefficients of {axis} average two laws and fit neither; the commanded parts are too short to "
        "identify one",
        f"fly {axis} with commands that do not rest at zero: sines, or steps from one speed to another",
        axis,
    )
