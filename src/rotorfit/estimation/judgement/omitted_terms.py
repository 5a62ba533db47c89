"""Test of the law against what it leaves out: limits of the acceleration, a drag of the square, a slow part.

A vehicle that obeys the law and, one time, such a term has innovations that contain the response to the term, less
what the fit has absorbed of it. Regressed on that response, they give a factor: 0 without the term; 1 with a limit of
the size that is tried; of drag, the coefficient in units of b over the root mean square of the speed; of a slow part,
the share by which commands that last are answered otherwise than short ones, as by an integral part. What the fit has
absorbed is known, too: the estimates are off by the factor times their weights' sum over the response. The sizes of the
limits are not known, so several are tried, each of which takes off another share.

General tests of the law hardly see such terms, because lag and damping take their place, and their intervals exclude
the vehicle's values in small motion, or the final speed.

Source: Z. Griliches, Journal of Farm Economics 39 (1957), pp. 8-20 (the bias by what a regression leaves out); T. S.
Breusch, A. R. Pagan, Review of Economic Studies 47 (1980), pp. 239-253 (tests of a term that is left out); W. K. Newey,
K. D. West, Econometrica 55 (1987), pp. 703-708 (the variance of the factor).
"""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from rotorfit.core.frames import Array, heading_from_world, world_from_heading
from rotorfit.core.laws import DAMPING, FIRST_ORDER_DELAY, GAIN, TRIM
from rotorfit.dynamics.first_order_low_pass import first_order_low_pass
from rotorfit.dynamics.limited_motion import limited_motion
from rotorfit.estimation.judgement.residual_variance import Weighted, orthonormal
from rotorfit.estimation.likelihood.axis_estimate import Estimate
from rotorfit.estimation.likelihood.block_response import response
from rotorfit.estimation.likelihood.blocks import Record
from rotorfit.estimation.likelihood.likelihood import segments, whiten
from rotorfit.estimation.likelihood.parameters import Point
from rotorfit.estimation.regression.paper import newey_west

BOUND_SHARES = 0.005, 0.01, 0.02, 0.04, 0.08
"""Shares of the acceleration asked for that the bounds take off: less does no harm, more is seen by other tests."""

JERK_SHARES = 0.05, 0.1, 0.2, 0.4
"""The same of the bounds on its change, by which it is late more often than it is missing."""

JERKS = 0.1, 0.2, 0.5, 1.0, 2.0, 5.0, 10.0, 20.0, 50.0, 100.0
"""Changes, in root mean squares of the acceleration asked for in a second, between which those shares lie."""

SLOW = 3.0
"""Time over which commands are averaged to give their slow part [s]."""

STEP = 0.02
"""Step of the grid [s]: short beside the shortest time constants of a vehicle."""

MEMORY = 1.0
"""Time over which contributions to the score are correlated [s]."""


@dataclass(frozen=True)
class OmittedTerm:
    """The term that is likeliest of those that the law leaves out.

    Attributes:
        kind: "bound" on the acceleration, "jerk" for one on its change, "drag" of the square of the speed, "slow" part.
        size: Of a limit [m/s^2 or rad/s^2; m/s^3 or rad/s^3 of "jerk"]; of "drag", its coefficient [1/m or 1/rad]; of
            "slow", the share of the input that it adds.
        statistic: Square of its factor over the variance; 0 where the sign is not that of the term.
        p_value: Probability of so large a factor for any of the terms if there is none.
        sd: Quantity to the standard deviation that the term adds to its estimate, in its standard errors.
    """

    kind: str
    size: float
    statistic: float
    p_value: float
    sd: Mapping[str, float]


def omitted_term(estimate: Estimate, weighted: Sequence[Weighted], errors: Mapping[str, float]) -> OmittedTerm | None:
    """The likeliest term that the law of an axis leaves out.

    Args:
        estimate: Estimate by the likelihood.
        weighted: Its innovations and weights, in the order of `errors`.
        errors: Standard errors of its quantities on their scales, by name.

    Returns:
        None under laws other than linear ones of the first order, and where the data would show none of the terms.
    """
    from scipy.special import ndtr

    if not _applies(estimate):
        return None
    terms = list(_terms([_grids(*one) for one in _flights(estimate)], estimate.place))
    responses = _responses(estimate, terms)
    factor, error = _factors(weighted, responses)
    z = np.where([one.kind == "slow" for one in terms], np.abs(factor), factor) / error
    off = [0.0 if one.kind in ("drag", "slow") else f - 1 for one, f in zip(terms, factor, strict=True)]
    likelier = np.where(error < 1, z * np.abs(z) - (off / error) ** 2, -np.inf)  # not beyond one standard error
    if not np.isfinite(likelier).any():
        return None
    a = int(np.argmax(likelier))
    term, tests = terms[a], sum(2 if one.kind == "slow" else 1 for one, e in zip(terms, error, strict=True) if e < 1)
    taken = float(np.sqrt(max(factor[a] ** 2 - error[a] ** 2, 0.0)))
    wrong = _errors(term, list(errors), weighted, [rows[..., a] for rows in responses])
    return OmittedTerm(
        term.kind,
        term.size * (float(factor[a]) if term.kind in ("drag", "slow") else 1.0),
        max(float(z[a]), 0.0) ** 2,
        min(1.0, tests * float(ndtr(-z[a]))),
        {name: taken * abs(by) / errors[name] for name, by in wrong.items()},
    )


def _applies(estimate: Estimate) -> bool:
    """Whether the law is of the first order and linear."""
    structures = estimate.optimum.point.structures or (FIRST_ORDER_DELAY,)
    return all(one.linear and not one.kicks and one.order < 2 for one in structures)


def _factors(weighted: Sequence[Weighted], responses: Sequence[Array]) -> tuple[Array, Array]:
    """Factor of each term and its standard error, both (A,)."""
    left = [_left(one, rows) for one, rows in zip(weighted, responses, strict=True)]
    power = np.maximum(sum(np.sum(rows**2, axis=(0, 1)) for rows in left), np.finfo(float).tiny)
    pairs = list(zip(weighted, left, strict=True))
    factor = sum(np.einsum("bka,bk->a", rows, one.innovation) for one, rows in pairs) / power
    variance = sum(_variance(one, rows, factor) for one, rows in pairs)
    return factor, np.sqrt(np.maximum(variance, power)) / power


def _errors(
    term: "_Term", names: Sequence[str], weighted: Sequence[Weighted], rows: Sequence[Array]
) -> dict[str, float]:
    """Errors of the estimates by a term with a factor of 1, from its whitened responses (B, K).

    Of a slow part only the answer to commands that last is wrong: the law still describes that to short ones.
    """
    absorbed = sum(np.einsum("bk,bkq->q", own, one.weight) for one, own in zip(weighted, rows, strict=True))
    concerned = ("steady_gain", "total_lag") if term.kind == "slow" else names
    return {name: float(absorbed[q]) for q, name in enumerate(names) if name in concerned}


def _left(one: Weighted, rows: Array) -> Array:
    """What the fit has not absorbed of the responses (B, K, A) of one flight."""
    flat, basis = rows.reshape(-1, rows.shape[-1]), orthonormal(one.span.reshape(-1, one.span.shape[-1]))
    return np.asarray(flat - basis @ (basis.T @ flat)).reshape(rows.shape)


def _variance(one: Weighted, rows: Array, factor: Array) -> Array:
    """Variance of the score of each term (A,), from what its factor leaves of the innovations of one flight."""
    score = np.einsum("bka,bka->ba", rows, one.innovation[:, :, None] - factor * rows)
    return newey_west(one.time, score - score.mean(axis=0), MEMORY).diagonal()


@dataclass(frozen=True)
class _Term:
    """A term with the factor 1.

    Attributes:
        kind: As of `OmittedTerm`.
        size: Likewise.
        added: What it adds to the acceleration of each flight on the grids of its segments, one after the other, in
            the heading frame, (G, K) each.
    """

    kind: str
    size: float
    added: list[Array]


@dataclass(frozen=True)
class _Grid:
    """What drives the motion on a grid of times of one segment; see `limited_motion`."""

    time: Array
    command: Array
    yaw: Array
    law: Array
    velocity: Array

    def limited(self, acceleration: float = np.inf, jerk: float = np.inf) -> tuple[Array, Array, Array]:
        """Accelerations asked for, what the limits add to them, and velocities."""
        return limited_motion(STEP, self.command, self.yaw, self.law, self.velocity, acceleration, jerk)


def _terms(flights: Sequence[Sequence[_Grid]], k: int) -> Iterator[_Term]:
    """The terms that are tried on axis k, from the grids of each flight."""

    def added(acceleration: float = np.inf, jerk: float = np.inf) -> list[Array]:
        return [np.concatenate([part.limited(acceleration, jerk)[1] for part in parts]) for parts in flights]

    free = [[part.limited() for part in parts] for parts in flights]
    asked = np.concatenate([one[0] for parts in free for one in parts])
    speed = float(np.sqrt(np.mean(np.concatenate([np.sum(one[2] ** 2, axis=1) for parts in free for one in parts]))))
    if not asked.any() or not speed:
        return
    for bound in _bounds(asked):
        yield _Term("bound", bound, added(acceleration=bound))
    jerks = float(np.sqrt(np.mean(asked**2))) * np.array(JERKS)
    shares = [sum(np.sum(np.linalg.norm(one, axis=1)) for one in added(jerk=jerk)) / asked.sum() for jerk in jerks]
    for jerk in np.exp(np.interp(JERK_SHARES, shares[::-1], np.log(jerks[::-1]))):
        yield _Term("jerk", float(jerk), added(jerk=float(jerk)))
    yield _slow(flights)
    damping = flights[0][0].law[:, DAMPING]
    by_speed = [[-damping * np.linalg.norm(v, axis=1)[:, None] / speed * v for *_, v in parts] for parts in free]
    yield _Term("drag", float(damping[k]) / speed, [np.concatenate(parts) for parts in by_speed])


def _slow(flights: Sequence[Sequence[_Grid]]) -> _Term:
    """The slow part of the demand, averaged in the world, where a velocity loop integrates."""
    return _Term("slow", 1.0, [np.concatenate([_averaged(part) for part in parts]) for parts in flights])


def _averaged(part: _Grid) -> Array:
    """The demand of a segment averaged over `SLOW`, in the heading frame, (G, K)."""
    demand, keep = part.command * part.law[:, GAIN], float(np.exp(-STEP / SLOW))
    if demand.shape[1] == 1:
        return first_order_low_pass(demand, keep)
    return heading_from_world(first_order_low_pass(world_from_heading(demand, part.yaw), keep), part.yaw)


def _bounds(asked: Array) -> list[float]:
    """Bounds that take each of the `BOUND_SHARES` off accelerations asked for (N,)."""
    size = np.sort(asked)[::-1]
    above = np.cumsum(size) - size * np.arange(1, size.size + 1)
    return [float(one) for one in np.interp(np.array(BOUND_SHARES) * size.sum(), above, size)]


def _responses(estimate: Estimate, terms: Sequence[_Term]) -> list[Array]:
    """The whitened response of each flight to what the terms add on its axis, (B, K, A)."""
    point, K = estimate.optimum.point, estimate.optimum.point.gain.size
    unit = replace(point, gain=np.ones(K), delay=np.zeros(K), structures=(), extra=np.zeros((0, K)))
    out = []
    for j, (rec, _, _, at) in enumerate(_flights(estimate)):
        times = _times(rec)
        ends = np.cumsum([0, *(time.size for time in times)])
        driven = replace(rec, command_time=np.concatenate(times), command_range=np.stack([ends[:-1], ends[1:]], axis=1))
        columns = [  # a view would keep every sensitivity of every term
            response(replace(driven, command=one.added[j]), unit, j, point.start[at])[1][:, estimate.place].copy()
            for one in terms
        ]
        rows = np.stack(columns, axis=1) if columns else np.zeros((len(rec.block_time), 0, K))
        out.append(whiten(rec, rows, point.levels)[0].transpose(0, 2, 1))
    return out


def _flights(estimate: Estimate) -> list[tuple[Record, Point, int, slice]]:
    """Each flight, the point, and the flight's rows of the trims and of the starts."""
    pairs = zip(estimate.records, segments(estimate.records), strict=True)
    return [(rec, estimate.optimum.point, j, at) for j, (rec, at) in enumerate(pairs)]


def _times(rec: Record) -> list[Array]:
    """The times of the grid of each segment."""
    ends = rec.pose_time[rec.pose_range[:, 1] - 1]
    return [np.arange(start, end, STEP) for start, end in zip(rec.starts, ends, strict=True)]


def _grids(rec: Record, point: Point, flight: int, at: slice) -> list[_Grid]:
    """The grid of each segment."""
    command_time, command, command_range = rec.switches
    law = point.laws
    law[:, TRIM] = point.trim[flight]
    out = []
    for s, ((first, last), time) in enumerate(zip(command_range, _times(rec), strict=True)):
        held = [
            np.maximum(np.searchsorted(command_time[first:last], time - delay, side="right") - 1, 0) + first
            for delay in point.delay
        ]
        forced = np.column_stack([command[held[k], k] for k in range(point.gain.size)])
        out.append(_Grid(time, forced, np.interp(time, rec.pose_time, rec.yaw), law, point.start[at][s].copy()))
    return out
